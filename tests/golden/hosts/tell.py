"""What the host's side of every frame layout says and makes of answers, over long conversations with emulated drives.

Drives are enabled, commanded, fail, fall silent and are reset as it happens; among their answers are frames that are
damaged, repeated, for others or nothing.
"""

import tempfile
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from random import Random
from typing import Any, NamedTuple

from drivers.config import BusConfig
from drivers.families.cia402.cia301 import EDS
from drivers.frame import Frame
from drivers.protocols import device_protocol, host_protocol
from drivers.protocols.base import Command, DeviceProtocol, DriveStatus, HostProtocol, Reject, Sample
from drivers.protocols.frame_text import layout_reader
from hil.rig.file import load_rig
from hil.rig.schema import RigConfig
from sim_plant.emulator import EmulatedStage
from tests.golden.golden import sha256
from tests.support.fuzz_frames import Mutator
from tests.support.paged_dbc import TEXT, bound
from tests.support.paths import RIGS

TICKS = 100
SWITCH, BEAT = {"message": "Switch", "signal": "On"}, {"message": "Beat", "period_s": 0.005}

NODES = (
    "bus.cia402.write_rated_torque=true",
    "bus.cia402.nodes=[3, 9, 4, 17]",
    "bus.cia402.rated_torque=[0.65, 0.65, 0.5, 0.01]",
)


class Talk(NamedTuple):
    """A rig and what is changed of it. binding: of paged_dbc.py's file, in place of the rig's layout. pieces: of TICKS,
    so many that the drives are configured early in them.
    """

    rig: str
    overrides: tuple[str, ...] = ()
    binding: dict[str, Any] | None = None
    pieces: int = 8


TALKS = {
    "stage_fd": Talk("microscope-ideal"),
    "stage_fd, turned": Talk("paper", ("axes.x.direction=-1",)),
    "stage_classic": Talk("microscope-ideal", ("bus.protocol=stage_classic",)),
    "cia402": Talk("microscope-ideal", ("bus.protocol=cia402",), pieces=14),
    "cia402, rpdos of their own": Talk(
        "microscope-ideal",
        ("bus.protocol=cia402", f'bus.cia402.eds=["{EDS}"]', "bus.cia402.rpdo=own", *NODES),
        pieces=14,
    ),
    "dbc": Talk("paper-dbc"),
    "odrive": Talk("odrive"),
    "vesc": Talk("vesc"),
    "damiao": Talk("damiao"),
    "cubemars": Talk("cubemars"),
    "robstride": Talk("robstride"),
    "moteus": Talk("moteus"),
    "moteus, whole numbers": Talk("moteus", ("bus.moteus.position=float", "bus.moteus.torque=int16")),
    "moteus, short ones": Talk("moteus", ("bus.moteus.position=int16", "bus.moteus.torque=int32")),
    "pages": Talk("paper", (), bound()),
    "pages, all asked for": Talk("paper", (), bound(remote=["Told0", "Told1"])),
    "pages, asked for seldom": Talk(
        "paper",
        (),
        bound(remote=["Told0", "Told1"], periodic=[{"message": "Told1", "period_s": 0.01}, BEAT], on_change=[]),
    ),
    "pages, a bit for each axis": Talk("paper", (), bound(enable=[SWITCH], start=[], stop=[])),
    "pages, one switch for all": Talk("paper", (), bound(enable=[SWITCH | {"on": 5, "off": 3}], start=[], stop=[])),
    "pages, one start for all": Talk("paper", (), bound(start=[SWITCH | {"value": 1}], stop=[SWITCH])),
}


@contextmanager
def _asked(name: str) -> Iterator[tuple[RigConfig, list[float], Path]]:
    """The rig of a conversation, the rated forces of its axes, and the folder that its layout's files are in."""
    asked = TALKS[name]
    rig = load_rig(RIGS / f"{asked.rig}.toml", list(asked.overrides))
    rated = [axis.rated_force for axis in rig.axes.values()]
    if asked.binding is None:
        yield rig, rated, RIGS
        return
    with tempfile.TemporaryDirectory() as made:
        folder = Path(made)
        (folder / "pages.dbc").write_text(TEXT, encoding="ascii")
        bus = BusConfig.model_validate({"protocol": "dbc:pages.dbc", "dbc": asked.binding})
        yield rig.model_copy(update={"bus": bus}), rated, folder


def frames_in_words(name: str) -> list[str]:
    """What a reader of the bus is told of all that is said."""
    seen: list[Frame] = []
    for _ in talk(name, seen):
        pass
    with _asked(name) as (rig, rated, folder):
        read = layout_reader(rig.bus, rig.axis_names, rated, folder, rig.mountings)
        return [read(frame) for frame in seen]


def talk(name: str, seen: list[Frame] | None = None) -> Iterator[list[str]]:
    """Piece by piece what was sent, what came in and what the host made of it. seen: gets every frame."""
    with _asked(name) as (rig, rated, folder):
        host = host_protocol(rig.bus, len(rated), rated, folder, rig.period_ns, rig.mountings)
        device = device_protocol(rig.bus, len(rated), rated, folder, rig.mountings)
        stage = EmulatedStage(
            rig.plant, rig.bus, rig.axis_names, rated, folder, drives=rig.drives, mountings=rig.mountings
        )
    draw, mutator, heard = Random(name), Mutator(rig.bus.protocol, 1), list[Frame]()
    enable = 0
    head = _facts(host, device, rig.period_ns)
    for piece in range(TALKS[name].pieces):
        lines = head if piece == 0 else []
        for tick in range(piece * TICKS, (piece + 1) * TICKS):
            now_ns = (tick + 1) * rig.period_ns
            noise = [mutator.frame(now_ns) for _ in range(draw.randrange(3))] if tick > 3 * TICKS else []
            lines += [f"{_hex(frame)} : {_told(host.decode(frame))}" for frame in [*heard, *noise]]
            if seen is not None:
                seen += [*heard, *noise]
            if draw.randrange(40) == 0 or tick == 2 * TICKS:
                enable = draw.choice((0, (1 << len(rated)) - 1, (1 << len(rated)) - 1, 1))
            force = [
                draw.choice((0.0, 0.01, -0.3, 0.9, -1.0)) * most * (enable >> at & 1) for at, most in enumerate(rated)
            ]
            sent = host.encode(Command(tick, force, enable, tick % 90 < 8))
            lines.append(f"{now_ns} {enable} {force} > {' '.join(map(_hex, sent))} {list(host.problems)}")
            if seen is not None:
                seen += sent
            lines += [f"{_hex(frame)} . {_obeyed(device.decode_command(frame))}" for frame in [*sent, *noise]]
            at, status = tick % len(rated), tick * 37 % 128
            sample = Sample(
                at, tick * 7919 % 20_001 - 10_000, status, max(tick - 1, 0) % (host.sequence_modulus or 1), now_ns
            )
            lines.append(_hex(device.encode_feedback(sample)))
            heard = _answers(stage, sent, now_ns, mutator) if draw.randrange(50) else []
            _hurt(stage, draw)
        yield lines


def _facts(host: HostProtocol, device: DeviceProtocol, period_ns: int) -> list[str]:
    """What both ends say of themselves; numbers of one kind, so that the compiled build says them alike."""
    ends = [(float(low), float(high)) for low, high in host.positions]
    lines = [f"{host.fd} {host.echo_id} {host.sequence_modulus} {ends} {list(host.acts_ns)} {host.state_ns}"]
    for name, can_id, length, fd, *times, sender, after, brs, _, at_rest in host.messages(period_ns):
        when = [int(time_ns) for time_ns in times]
        also = f"{' slow' if fd and not brs else ''}{f' at rest {at_rest}' if at_rest else ''}"
        lines.append(f"{name} {can_id} {length} {bool(fd)} {when} {sender} {after}{also}")
    lag, resolution = getattr(device, "enable_lag", 0), float(getattr(device, "force_resolution", 0.0))
    fd, modulus = bool(getattr(device, "fd", False)), int(getattr(device, "sequence_modulus", 0))
    return [*lines, f"{device.n_axes} {fd} {modulus} {lag} {resolution!r}"]


def _answers(stage: EmulatedStage, sent: list[Frame], now_ns: int, mutator: Mutator) -> list[Frame]:
    heard = []
    for frame in sent:
        mutator.keep(frame)
        for answer in stage.on_frame(frame._replace(timestamp_ns=now_ns + 300_000)):
            heard.append(answer._replace(timestamp_ns=now_ns + 400_000))
            mutator.keep(heard[-1])
    return heard


def _hurt(stage: EmulatedStage, draw: Random) -> None:
    """Now and then a drive fails, or says more than it should."""
    drive = draw.choice(stage.drives)
    if draw.randrange(120) == 0:
        drive.fail()
    if draw.randrange(30) == 0:
        said = (0, 0, 0, DriveStatus.FAULT, DriveStatus.ENCODER_FAULT, DriveStatus.TORQUE_LIMITED, DriveStatus.WATCHDOG)
        drive.extra_status = int(draw.choice(said))


def _hex(frame: Frame) -> str:
    return f"{frame.can_id:X}#{frame.flags}{frame.data.hex()}"


def _told(outcome: Sample | Reject | tuple[Sample, ...]) -> str:
    if isinstance(outcome, Reject):
        return outcome.name
    samples = outcome if isinstance(outcome, tuple) else (outcome,)
    return " ".join(f"{s.axis}:{s.position}:{int(s.status)}:{s.sequence}:{s.stamp_ns}" for s in samples)


def _obeyed(outcome: Command | Reject) -> str:
    if isinstance(outcome, Reject):
        return outcome.name
    return f"{outcome.sequence} {[float(force) for force in outcome.force]} {int(outcome.enable)} {bool(outcome.reset)}"


def stories() -> list[str]:
    """Their names."""
    return list(TALKS)


def tell(story: str) -> list[str]:
    """Of each piece, what the host made of what it heard; then how frames are put into words."""
    return [*lines(list(talk(story))), *words(frames_in_words(story))]


def full(story: str) -> list[str]:
    """Every frame, and every frame in words."""
    return [*(line for piece in talk(story) for line in piece), *frames_in_words(story)]


def outcomes(piece: Sequence[str]) -> list[str]:
    """What was made of each frame that was heard."""
    return [line.split(" : ")[1] for line in piece if " : " in line]


def lines(pieces: Sequence[Sequence[str]]) -> list[str]:
    """A line a piece."""
    told = []
    for number, piece in enumerate(pieces):
        heard = Counter(
            what if what in Reject.__members__ else "samples" if what else "parts" for what in outcomes(piece)
        )
        counts = ", ".join(f"{name} {count}" for name, count in sorted(heard.items()))
        told.append(f"piece {number}: {len(piece)} lines; heard {counts}; sha256 {sha256(chr(10).join(piece))}")
    return told


def words(texts: Sequence[str]) -> list[str]:
    """The first text of every kind, which is its first word, and the hash of all."""
    first: dict[str, str] = {}
    for text in texts:
        first.setdefault(text.partition(" ")[0], text)
    return [
        *(f"in words: {text}" for text in first.values() if text),
        f"sha256 of all words: {sha256(chr(10).join(texts))}",
    ]
