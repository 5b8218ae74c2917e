"""CiA 402 drives alone on a bus, without a stage: test doubles for masters, in real time, that say what they do."""

import os
import re
import select
import time
from collections.abc import Callable, Sequence
from math import pi
from pathlib import Path
from typing import NamedTuple

from drivers.bus.any_bus import AnyPort
from drivers.families.cia402 import cia301
from drivers.families.cia402.services import service_text
from drivers.frame import Frame
from sim_plant.config import EmulatedDriveConfig
from sim_plant.drives.motion_drive import EMULATED, NEGATIVE_LIMIT, POSITIVE_LIMIT, MotionDrive
from sim_plant.drives.motor import Motor
from sim_plant.drives.object_dictionary import described, key_of
from sim_plant.drives.quirks import stated_quirks
from sim_plant.drives.servo import NEVER_NS, ServoDrive
from sim_plant.process import StopSignals

_SWITCHES = {"limit-": NEGATIVE_LIMIT, "limit+": POSITIVE_LIMIT, "limits-off": 0}
_INPUTS = re.compile(r"inputs=(0[xX][0-9a-fA-F]{1,8}|0|[1-9][0-9]{0,9})")
_WORDS = ("fault", "reboot", "off", "mute", "unmute", "block", "unblock", *_SWITCHES)
ORDERS = (*_WORDS, "inputs=VALUE")
_WAIT_S = 0.002  # how late a heartbeat or an expiry may be


class DoubleSettings(NamedTuple):
    """Of every drive. rated_torque: N m; None: as its file's 6076h says, else 1. counts: of its encoder, per turn.
    inertia: kg m^2. friction: N m s/rad.

    watchdog_s: without a new target for this long it goes to FAULT; 0: it has none. boot_s: until its boot-up message.
    """

    rated_torque: float | None
    counts: int
    inertia: float
    friction: float
    watchdog_s: float
    boot_s: float
    quirks: EmulatedDriveConfig


def make_drive(eds: Path, node: int, settings: DoubleSettings, now_ns: int) -> MotionDrive:
    """One drive by its EDS. Raises ValueError for one that cannot be read."""
    resolution = 2.0 * pi / settings.counts
    watchdog_ns = round(settings.watchdog_s * 1e9) or NEVER_NS
    rated = settings.rated_torque or stated_torque(eds, node) or 1.0
    servo = ServoDrive(0, rated, resolution, watchdog_ns, False, 0)
    motor = Motor(settings.inertia, settings.friction, resolution, now_ns)
    return MotionDrive(node, servo, motor, eds=eds, quirks=stated_quirks(settings.quirks))


def stated_torque(eds: Path, node: int) -> float:
    """Rated torque that a file gives a drive by 6076h, N m; 0 where it gives none. Raises ValueError."""
    entry = described(eds, node).entries.get(key_of(cia301.TORQUE_RATED))
    return entry.default * 1e-3 if entry is not None and not isinstance(entry.default, bytes) else 0.0


def stated_inputs(word: str) -> int | None:
    """60FDh that an order asks for; None for another order."""
    if word in _SWITCHES:
        return _SWITCHES[word]
    stated = _INPUTS.fullmatch(word)
    value = int(stated[1], 0) if stated else -1
    return value if 0 <= value <= 0xFFFFFFFF else None


class Reporter:
    """Says what becomes of one drive: each change of its states and its mode, refused accesses, emergencies.

    every: each service frame of its too.
    """

    def __init__(self, drive: MotionDrive, say: Callable[[str], None], *, every: bool) -> None:
        self._drive, self._say, self._every = drive, say, every
        self._last: list[str] = []
        self._requests = cia301.SDO_REQUEST_ID + drive.node_id

    def look(self) -> None:
        """At the drive's states."""
        drive = self._drive
        now = [
            drive.nmt.name.lower().replace("_", "-"),
            drive.state.name.lower().replace("_", " "),
            f"mode {EMULATED.get(drive.mode, '0')}",
        ]
        changed = [text for text, before in zip(now, self._last or [""] * len(now), strict=True) if text != before]
        self._last = now
        if changed:
            self._say(f"node {drive.node_id}: {', '.join(changed)}")

    def heard(self, frame: Frame) -> None:
        """A frame from the bus."""
        if self._every and frame.can_id in (cia301.NMT_ID, self._requests):
            self._say(service_text(frame))

    def sent(self, frame: Frame) -> None:
        """A frame of the drive."""
        text = service_text(frame)
        aborted = frame.can_id == cia301.SDO_RESPONSE_ID + self._drive.node_id and frame.data[0] == 0x80
        emergency = frame.can_id & 0x780 in (cia301.EMCY_ID, 0x680)
        heartbeat = frame.can_id & 0x780 == cia301.HEARTBEAT_ID
        if text and (aborted or emergency or (self._every and not heartbeat)):
            self._say(text)


class DriveDouble:
    """The loop around the drives of one bus; time.monotonic_ns is its clock. say: takes one line of text."""

    def __init__(
        self,
        drives: Sequence[MotionDrive],
        port: AnyPort,
        say: Callable[[str], None],
        *,
        every: bool,
        boot_s: float = 0.0,
    ) -> None:
        self.drives = list(drives)
        self._port = port
        self._reporters = [Reporter(drive, say, every=every) for drive in drives]
        self._say = say
        self._muted = False
        self._boot_ns = time.monotonic_ns() + round(boot_s * 1e9)

    def run(self, seconds: float | None, orders: int | None = None) -> None:
        """Until SIGTERM, SIGINT or SIGHUP, or for so long. orders: a descriptor to read lines of ORDERS from."""
        end_ns = time.monotonic_ns() + round(seconds * 1e9) if seconds is not None else NEVER_NS
        with StopSignals() as stop:
            while not stop.seen and time.monotonic_ns() < end_ns:
                orders = self._take_orders(orders)
                first = self._port.wait(_WAIT_S)
                now_ns = time.monotonic_ns()
                self.step(([first] if first else []) + self._port.drain(now_ns), now_ns)

    def _take_orders(self, orders: int | None) -> int | None:
        """Follow the orders there are; the descriptor as long as more may come."""
        if orders is None or not select.select([orders], [], [], 0)[0]:
            return orders
        text = os.read(orders, 4096).decode(errors="replace")
        for word in text.split():
            self.order(word)
        return orders if text else None

    def order(self, word: str) -> None:
        """One of ORDERS, to every drive: what their surroundings do to them."""
        inputs = stated_inputs(word)
        if inputs is not None:
            for drive in self.drives:
                drive.inputs = inputs
        elif word not in _WORDS:
            self._say(f"{word!r} is no order; there are {', '.join(ORDERS)} of 0 to 0xFFFFFFFF")
        elif word in ("mute", "unmute"):
            self._muted = word == "mute"
        elif word in ("block", "unblock"):
            for drive in self.drives:
                drive.blocked = word == "block"
        else:
            for drive in self.drives:
                {"fault": drive.servo.fail, "reboot": drive.reboot, "off": drive.switch_off}[word]()

    def step(self, frames: Sequence[Frame], now_ns: int) -> None:
        """Answer frames, then let the drives live until now_ns."""
        if now_ns < self._boot_ns:
            return
        for frame in frames:
            for drive, reporter in zip(self.drives, self._reporters, strict=True):
                reporter.heard(frame)
                self._expire(drive, frame.timestamp_ns)
                self._send(reporter, drive.on_frame(frame))
        for drive, reporter in zip(self.drives, self._reporters, strict=True):
            self._expire(drive, now_ns)
            self._send(reporter, drive.advance(now_ns))

    def _expire(self, drive: MotionDrive, now_ns: int) -> None:
        if drive.servo.deadline_ns < now_ns:
            drive.servo.trip(drive.servo.deadline_ns)

    def _send(self, reporter: Reporter, frames: Sequence[Frame]) -> None:
        for frame in frames:
            reporter.sent(frame)
            if not self._muted:
                self._port.send(frame)
        reporter.look()
