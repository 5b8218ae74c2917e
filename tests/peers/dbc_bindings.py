"""Random bindings of DBC files: each is refused in one line, or it acts. Never a traceback.

Acting: the drives' side hears the torque that the host's side was told, and the host's side hears the position that the
drives' side was told, both within a step of their signals.
"""

import random
from collections import Counter
from collections.abc import Iterator, Sequence
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple
from unittest import mock

from drivers.config import BusConfig
from drivers.families.dbc import file as dbc_file
from drivers.protocols import device_protocol, host_protocol
from drivers.protocols.base import Command, LayoutError, Sample
from drivers.protocols.dbc_codec import load_dbc, parse_dbc
from tests.peers.files import Tried
from tests.peers.table import DIFFERS, PASSED, Row

PEER = "random bindings"
MS = 1_000_000
RATED = 5.0
FORCE = 3.0
_LARGEST = 100_000  # bytes of a file: each binding looks at every message
_FILES = 20


class Signal(NamedTuple):
    """message, name: in the file. step: physical units a bit. reach: least of both ends' magnitudes."""

    message: str
    name: str
    step: float
    reach: float
    is_float: bool
    is_signed: bool


def rows(files: Sequence[Tried], bindings: int) -> Iterator[Row]:
    """A row a file. bindings: of all files together."""
    chosen = [file for file in files if file.path.stat().st_size <= _LARGEST and _torques(file.path)][:_FILES]
    with mock.patch.object(dbc_file, "parse_dbc", cache(parse_dbc)):
        for file in chosen:
            draw, count, wrong = random.Random(file.path.name), Counter[str](), ""
            for _ in range(-(-bindings // len(chosen))):
                outcome = tried(file.path, draw)
                count[outcome or "acts"] += 1
                if outcome not in ("", "refused"):
                    wrong = wrong or outcome
            told = wrong or f"{count['acts']} act, {count['refused']} refused"
            yield Row(PEER, file.name, DIFFERS if wrong else PASSED, told)


def signals(path: Path) -> list[Signal]:
    """All signals of a file; none of one that is not read."""
    try:
        database = load_dbc(path)
    except LayoutError:
        return []
    return [
        Signal(
            str(message.name),
            str(signal.name),
            abs(float(signal.scale)),
            (2.0 ** (signal.length - signal.is_signed) - 1.0) * abs(float(signal.scale)),
            bool(signal.is_float),
            bool(signal.is_signed),
        )
        for message in database.messages
        for signal in message.signals
        if signal.scale
    ]


def _torques(path: Path) -> list[Signal]:
    """Signals that could carry a torque; none of a file with one message, where nothing could answer."""
    found = signals(path)
    several = len({signal.message for signal in found}) > 1
    return [signal for signal in found if several and signal.is_signed and signal.reach]


def tried(path: Path, draw: random.Random) -> str:
    """Empty where a drawn binding acts, "refused" where it is refused in one line; else what is wrong with it."""
    n_axes = draw.choice((1, 1, 2))
    binding, torques, positions = drawn(_signals(path), n_axes, draw)
    try:
        bus = BusConfig.model_validate({"protocol": f"dbc:{path.name}", "dbc": binding})
        rated = [RATED] * n_axes
        host = host_protocol(bus, n_axes, rated, path.parent, MS)
        device: Any = device_protocol(bus, n_axes, rated, path.parent)
    except ValueError as error:
        return "refused" if isinstance(error, LayoutError) and "\n" not in str(error) else f"{binding}: {error!r}"[:300]
    except Exception as error:  # of any kind: it is what is looked for
        return f"{binding}: {type(error).__name__}: {error}"[:300]
    try:
        found = _command_heard(host, device, torques) or _position_heard(host, device, positions)
    except Exception as error:
        found = f"{type(error).__name__}: {error}"
    return f"{binding}: {found}"[:700] if found else ""


_signals = cache(signals)
_SINGLE = FORCE * 2.0**-23  # what a signal of single precision leaves of it


def drawn(known: Sequence[Signal], n_axes: int, draw: random.Random) -> tuple[dict[str, Any], list[float], list[float]]:
    """[bus.dbc], and a step of each torque, N, and of each position, counts."""
    binding: dict[str, Any] = {"torque": [], "position": []}
    steps: dict[str, list[float]] = {"torque": [], "position": []}
    signed = [signal for signal in known if signal.is_signed and signal.reach] or list(known)
    for key in ("torque", "position"):
        fit = signed if key == "torque" and draw.random() < 0.8 else list(known)
        said = {item["message"] for item in binding["torque"]}
        fit = [signal for signal in fit if signal.message not in said] if draw.random() < 0.9 else fit
        first = draw.choice(fit or known)
        for axis in range(n_axes):
            beside = [signal for signal in fit if signal.message == first.message and signal != first]
            signal = first if axis == 0 else draw.choice(beside if beside and draw.random() < 0.5 else known)
            fitting = 1.1 * RATED / signal.reach if signal.reach and key == "torque" else 1.0
            scale = fitting * (1.0 if draw.random() < 0.8 else 10.0 ** draw.uniform(-3, 3))
            binding[key].append({"message": signal.message, "signal": signal.name, "scale": scale})
            steps[key].append(scale * (1e-3 if signal.is_float else signal.step))
    for key, count, more in _OPTIONAL:
        if draw.random() < 0.05:
            binding[key] = [_entry(known, binding, draw, more) for _ in range(count or n_axes)]
    if "command_counter" in binding or "feedback_counter" in binding:
        binding["command_counter"] = [_entry(known, binding, draw, ())]
        binding["feedback_counter"] = [_entry(known, binding, draw, ()) for _ in range(n_axes)]
    if "start" in binding or "stop" in binding:
        binding["start"], binding["stop"] = ([_entry(known, binding, draw, ("value",))] for _ in range(2))
    if draw.random() < 0.1:
        binding["feedback"] = "cyclic"
    return binding, steps["torque"], steps["position"]


_OPTIONAL = (
    ("enable", 1, ()),
    ("status", 0, ()),
    ("error", 0, ()),
    ("reset", 1, ()),
    ("constant", 1, ("value",)),
    ("start", 1, ("value",)),
    ("checksum", 1, ()),
    ("command_counter", 1, ()),
    ("feedback_counter", 0, ()),
    ("inputs", 1, ("axis", "input")),
)


def _entry(
    known: Sequence[Signal], binding: dict[str, Any], draw: random.Random, more: Sequence[str]
) -> dict[str, Any]:
    """A signal of a message that is bound already, or of any; now and then a name that is not there."""
    message = draw.choice(binding[draw.choice(("torque", "position"))])["message"]
    signal = draw.choice([s for s in known if s.message == message] if draw.random() < 0.7 else known)
    name = signal.name if draw.random() < 0.95 else signal.name + "x"
    values = {"value": draw.randrange(4), "axis": draw.randrange(3), "input": draw.choice(("home", "limit_low"))}
    return {"message": signal.message, "signal": name} | {key: values[key] for key in more}


def _command_heard(host: Any, device: Any, steps: Sequence[float]) -> str:
    """What is wrong with the torque that the drives hear in the second tick; empty where nothing is."""
    heard: list[Command] = []
    for sequence in range(2):
        frames = host.encode(Command(sequence, [FORCE] * len(steps), (1 << len(steps)) - 1, False))
        heard += [found for frame in frames if isinstance(found := device.decode_command(frame), Command)]
    if not heard:
        return "the drives hear no command"
    apart = [
        force for force, step in zip(heard[-1].force, steps, strict=True) if abs(force - FORCE) > 0.51 * step + _SINGLE
    ]
    return f"told {FORCE} N, the drives hear {heard[-1].force}" if apart else ""


def _position_heard(host: Any, device: Any, steps: Sequence[float]) -> str:
    """What is wrong with the positions that the host hears; empty where nothing is."""
    told = [round(max(-1e6, min(1e6, 0.6 * low + 0.4 * high))) for low, high in host.positions]
    told = [
        counts if low <= counts <= high else round((low + high) / 2)
        for counts, (low, high) in zip(told, host.positions, strict=True)
    ]
    frames = [frame for axis, counts in enumerate(told) for frame in device.frames_of(Sample(axis, counts, 0, -1, 0))]
    found: dict[int, float] = {}
    for frame in frames:
        outcome = host.decode(frame)
        samples = outcome if isinstance(outcome, tuple) and not isinstance(outcome, Sample) else (outcome,)
        found |= {sample.axis: sample.position for sample in samples if isinstance(sample, Sample)}
    for axis, (counts, step) in enumerate(zip(told, steps, strict=True)):
        if axis not in found or abs(found[axis] - counts) > 0.51 * step + 1.0:
            return f"told {told} counts, the host hears {found}"
    return ""
