"""One servo drive of the emulated stage: encoder, force, latches, and its own watchdog on the host's commands.

Rules:
- A command is fresh when its sequence number is newer than the last fresh one (serial-number arithmetic, RFC 1982).
  Anything else is ignored: it changes no force, feeds no watchdog and is not answered.
- The watchdog is armed by the first fresh command and fed by every one after it. When it expires the force is zero at
  that very instant and stays so (latched).
- A drive fault is latched likewise. Both latches open on a rising edge of the command's reset bit: a fresh command
  with it clear, then a fresh one with it set. A reset bit that is left on does nothing.
- Expiry also forgets the last sequence number, because the host that comes back may be another process.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

from drivers.protocols.base import DriveStatus, Sample

NEVER_NS = 1 << 62
BOUNCE = 5e-6  # m (rad) to either side of where a bouncing contact closes

_ENABLED = int(DriveStatus.ENABLED)
_FAULT = int(DriveStatus.FAULT)
_WATCHDOG = int(DriveStatus.WATCHDOG)
_HOMED = int(DriveStatus.HOMED)
_BRAKE = int(DriveStatus.BRAKE)
_LIMIT_LOW, _LIMIT_HIGH = int(DriveStatus.LIMIT_LOW), int(DriveStatus.LIMIT_HIGH)
_HOME = int(DriveStatus.HOME)
_LATCHES = _FAULT | _WATCHDOG


class Trip(NamedTuple):
    """One expiry of a drive's watchdog: last fresh command, instant of zero force, and the force until then (N)."""

    command_ns: int
    expired_ns: int
    force: float


class Switches(NamedTuple):
    """Digital inputs of an axis, m (rad): closed at `low` and below, at `high` and above, at `home` and below.

    contact: what their contacts do instead: "dead" (never closed), "stuck" (always), "inverted", or "bouncing" within
    BOUNCE of where they close.
    """

    low: float = -math.inf
    high: float = math.inf
    home: float = -math.inf
    contact: str = "sound"

    def closed(self, position: float) -> int:
        """DriveStatus bits."""
        contact = self.contact
        if contact == "bouncing":
            position += BOUNCE * (round(position * 1e9) * 2654435761 % 2001 - 1000) * 1e-3
        bits = (
            (_LIMIT_LOW if position <= self.low else 0)
            | (_LIMIT_HIGH if position >= self.high else 0)
            | (_HOME if position <= self.home else 0)
        )
        if contact in ("sound", "bouncing"):
            return bits
        there = self.there
        return 0 if contact == "dead" else there if contact == "stuck" else there & ~bits

    @property
    def there(self) -> int:
        """DriveStatus bits of the switches that there are."""
        return (
            (_LIMIT_LOW if self.low > -math.inf else 0)
            | (_LIMIT_HIGH if self.high < math.inf else 0)
            | (_HOME if self.home > -math.inf else 0)
        )


NO_SWITCHES = Switches()


class Counter:
    """What an incremental encoder's counter says: from where it was switched on, and from its index once that has been
    passed. zero: m (rad), where it counts 0. index: m (rad); None: the encoder has none.
    """

    __slots__ = ("_index", "_last", "homed", "zero")

    def __init__(self, zero: float, index: float | None) -> None:
        self.zero = zero
        self.homed = False
        self._index = index
        self._last: float | None = None

    def give_up_index(self) -> float | None:
        """From now on it counts on at the index, which is another's to look for: where that is, m (rad)."""
        index, self._index = self._index, None
        return index

    def take(self, position: float) -> float:
        """What it says at a place, both m (rad)."""
        index, last = self._index, self._last
        if index is not None and last is not None and not self.homed and (last - index) * (position - index) <= 0.0:
            self.zero, self.homed = index, True
        self._last = position
        return position - self.zero


class ServoDrive:
    """One axis' drive. Times are integer ns on the emulator's clock.

    axis: index. rated_force: N, > 0. resolution: m per count. watchdog_ns: > 0. has_brake: engaged whenever the drive
    applies no force, and for opening_ns after it began to apply one. sequence_modulus: of the frame layout; 0 where it
    has no sequence (every valid command is fresh).

    force: N, applied now. status: DriveStatus bits. deadline_ns: when the watchdog expires (NEVER_NS: not armed).
    opens_ns: when its brake opens (NEVER_NS: it does not).
    last_command_ns: last fresh command, -1 before the first. trips: every expiry. stale: commands that were not fresh.
    gain: torque constant over its nominal value. switches: its digital inputs. counter: of an incremental encoder;
    None: the encoder knows the axis' position. extra_status: bits shown on top of
    `status`. taps: what a sample goes through before it is sent. broken: a fault that no reset clears. stuck: every
    command enables it, whatever its bit says. gain and the last four are for fault injection.
    """

    __slots__ = (
        "_reset_seen_low",
        "_sequence",
        "axis",
        "broken",
        "counter",
        "deadline_ns",
        "extra_status",
        "force",
        "gain",
        "has_brake",
        "last_command_ns",
        "modulus",
        "opening_ns",
        "opens_ns",
        "rated_force",
        "resolution",
        "stale",
        "status",
        "stuck",
        "switches",
        "taps",
        "trips",
        "watchdog_ns",
    )

    def __init__(
        self, axis: int, rated_force: float, resolution: float, watchdog_ns: int, has_brake: bool,
        sequence_modulus: int, *, opening_ns: int = 0,
    ) -> None:  # fmt: skip
        self.axis = axis
        self.rated_force = rated_force
        self.resolution = resolution
        self.watchdog_ns = watchdog_ns
        self.has_brake = has_brake
        self.opening_ns, self.opens_ns = opening_ns, NEVER_NS
        self.modulus = sequence_modulus
        self.force = 0.0
        self.gain = 1.0
        self.extra_status = 0
        self.broken = False
        self.stuck = False
        self.switches = NO_SWITCHES
        self.counter: Counter | None = None
        self.taps: list[Callable[[Sample], Sample]] = []
        self.status = _HOMED | (_BRAKE if has_brake else 0)
        self.deadline_ns = NEVER_NS
        self.last_command_ns = -1
        self.trips: list[Trip] = []
        self.stale = 0
        self._sequence = -1
        self._reset_seen_low = False

    def is_fresh(self, sequence: int) -> bool:
        """Whether a command with this sequence number is newer than the last fresh one."""
        modulus, last = self.modulus, self._sequence
        return last < 0 or not modulus or 0 < (sequence - last) % modulus < modulus // 2

    def on_command(self, force: float, enable: bool, reset: bool, sequence: int, now_ns: int) -> bool:
        """Take a valid command received at now_ns; False: it is not fresh, and nothing happened."""
        if not self.is_fresh(sequence):
            self.stale += 1
            return False
        self._sequence = sequence
        self.last_command_ns = now_ns
        self.deadline_ns = now_ns + self.watchdog_ns
        if not reset:
            self._reset_seen_low = True
        elif self._reset_seen_low:
            self._reset_seen_low = False
            self.status &= ~_LATCHES
            if self.broken:
                self.fail()
        limit = self.rated_force * 1.000001
        if not -limit <= force <= limit:  # also where it is not a number
            self.fail()
        elif (enable or self.stuck) and not self.status & _LATCHES:
            self.force = force * self.gain
            self.status |= _ENABLED
            if self.status & _BRAKE and self.opens_ns == NEVER_NS:
                self.opens_ns = now_ns + self.opening_ns
                self.open(now_ns)
        else:
            self._release()
        return True

    def sample(self, position: float, now_ns: int) -> Sample:
        """The encoder's count at now_ns, answering the last fresh command. position: truth, m."""
        status = self.status | self.extra_status
        if self.switches is not NO_SWITCHES:
            status |= self.switches.closed(position)
        if self.counter is not None:
            position = self.counter.take(position)
            if not self.counter.homed:
                status &= ~_HOMED
        sample = Sample(self.axis, round(position / self.resolution), status, self._sequence, now_ns)
        for tap in self.taps:
            sample = tap(sample)
        return sample

    def open(self, now_ns: int) -> None:
        """The brake opens if it is time."""
        if self.opens_ns <= now_ns:
            self.opens_ns = NEVER_NS
            self.status &= ~_BRAKE

    def trip(self, now_ns: int) -> None:
        """The watchdog expires at now_ns: zero force, latched."""
        self.trips.append(Trip(self.last_command_ns, now_ns, self.force))
        self._release()
        self.status |= _WATCHDOG
        self._forget()
        self.deadline_ns = NEVER_NS

    def fail(self) -> None:
        """The drive finds a fault: zero force, latched."""
        self._release()
        self.status |= _FAULT
        self._reset_seen_low = False

    def _forget(self) -> None:
        self._sequence = -1
        self._reset_seen_low = False

    def _release(self) -> None:
        self.force = 0.0
        self.status &= ~_ENABLED
        self.opens_ns = NEVER_NS
        if self.has_brake:
            self.status |= _BRAKE
