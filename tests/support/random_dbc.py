"""DBC files of all kinds, drawn at random, with a binding for a rig: for tests against cantools' own reading."""

from typing import Any, NamedTuple

from hypothesis import strategies as st

from drivers.frame import FD_LENGTHS

FLOATS = {32: 1, 64: 2}  # SIG_VALTYPE_ by length
NESTED_IN = 7  # the value of the first multiplexer that a second is there with
NOISE = """
BO_ 1999 Overlapping: 8 Other
 SG_ A : 0|16@1+ (1,0) [0|0] "" Host
 SG_ B : 8|16@1+ (1,0) [0|0] "" Host

BO_ 1998 Twice: 8 Other
 SG_ A : 0|16@1+ (1,0) [0|0] "" Host

BO_ 1997 Twice: 8 Other
 SG_ A : 0|16@1+ (1,0) [0|0] "" Host

BO_ 1996 NoSignals: 3 Other

BO_ 1995 BeyondItsEnd: 1 Other
 SG_ A : 0|16@1+ (1,0) [0|0] "" Host

"""
LONG = """
BO_ 2566844926 Diagnostics: 1785 Other
 SG_ Code : 0|19@1+ (1,0) [0|0] "" Host

"""


LONGER = [length for length in FD_LENGTHS if length > 8]


class Signal(NamedTuple):
    """One signal. start: as the file writes it. page: of its message's multiplexer; -1: on all. offset: physical."""

    name: str
    start: int
    length: int
    big: bool
    signed: bool
    is_float: bool
    factor: float
    page: int = -1
    offset: float = 0.0

    @property
    def line(self) -> str:
        """In a DBC file."""
        page = f" m{self.page}" if self.page >= 0 else ""
        order, sign = "0" if self.big else "1", "-" if self.signed or self.is_float else "+"
        place = f"{self.start}|{self.length}@{order}{sign}"
        return f' SG_ {self.name}{page} : {place} ({self.factor},{self.offset}) [0|0] "\xb5m" Host'


class Message(NamedTuple):
    """One message. can_id: as the file writes it. multiplexed: its first byte says the page. nested: its second does,
    while the first is NESTED_IN; two values of it each.
    """

    name: str
    can_id: int
    length: int
    multiplexed: bool
    signals: tuple[Signal, ...]
    nested: bool = False

    @property
    def text(self) -> str:
        """In a DBC file."""
        lines = [f"BO_ {self.can_id} {self.name}: {self.length} Drive"]
        if self.multiplexed:
            lines.append(' SG_ Page M : 0|8@1+ (1,0) [0|0] "" Host')
        if self.nested:
            lines.append(f' SG_ Sub m{NESTED_IN}M : 8|8@1+ (1,0) [0|0] "" Host')
        return "\n".join([*lines, *(signal.line for signal in self.signals), ""])

    @property
    def about(self) -> str:
        """What a DBC file says of it elsewhere: kinds of floating-point numbers, ranges of multiplexers, names of
        values.
        """
        lines = [
            f"SIG_VALTYPE_ {self.can_id} {signal.name} : {FLOATS[signal.length]};"
            for signal in self.signals
            if signal.is_float
        ]
        lines += [f'VAL_ {self.can_id} {s.name} 0 "zero" 1 "one";' for s in self.signals if not s.is_float]
        if self.nested:
            lines.append(f"SG_MUL_VAL_ {self.can_id} Sub Page {NESTED_IN}-{NESTED_IN};")
            for at, signal in enumerate(self.signals):
                lines.append(f"SG_MUL_VAL_ {self.can_id} {signal.name} Sub {2 * at}-{2 * at + 1};")
        return "".join(line + "\n" for line in lines)


class Drawn(NamedTuple):
    """A file, its binding, and what is bound where: by axis, (message, signal) of position and torque."""

    text: str
    binding: dict[str, Any]
    position: list[tuple[Message, Signal]]
    torque: list[tuple[Message, Signal]]
    n_axes: int


@st.composite
def signal_at(draw: st.DrawFn, name: str, first: int, size: int, page: int) -> Signal:
    """A signal within `size` bytes from byte `first` on; one without a sign counts from its middle."""
    big = draw(st.booleans())
    lengths = [length for length in FLOATS if length == 8 * size]
    if lengths and draw(st.booleans()):
        return Signal(name, 8 * first + (7 if big else 0), lengths[0], big, True, True, 1.0, page)
    length = draw(st.integers(max(10, 8 * size - 6), 8 * size))
    shift = draw(st.integers(0, 8 * size - length))
    start = 8 * first + (shift // 8 * 8 + 7 - shift % 8 if big else shift)
    factor, signed = draw(st.sampled_from([1.0, 0.5, 0.001])), draw(st.booleans())
    offset = draw(st.sampled_from([0.0, 3.0 * factor])) if signed else -factor * (1 << (length - 1))
    return Signal(name, start, length, big, signed, False, factor, page, offset)


@st.composite
def messages(draw: st.DrawFn, prefix: str, n_axes: int, first_id: int) -> list[tuple[Message, Signal]]:
    """A signal for each axis: in messages of their own, in one together, or on pages of one."""
    kind = draw(st.sampled_from(["own", "together", "pages", "nested"]))
    extended = 1 << 31 if draw(st.booleans()) else 0
    size = draw(st.integers(2, 4))
    if kind == "own":
        length = draw(st.one_of(st.integers(size, 8), st.sampled_from(LONGER)))
        made = []
        for axis in range(n_axes):
            signal = draw(signal_at(f"Value{axis}", draw(st.integers(0, length - size)), size, -1))
            message = Message(f"{prefix}{axis}", extended | first_id + axis, length, False, (signal,))
            made.append((message, signal))
        return made
    size = min(size, 8 // n_axes) if kind == "together" else size
    firsts = {"together": [axis * size for axis in range(n_axes)], "pages": [1] * n_axes, "nested": [2] * n_axes}[kind]
    signals = tuple(
        draw(signal_at(f"Value{axis}", first, size, -1 if kind == "together" else axis * (1 + (kind == "nested"))))
        for axis, first in enumerate(firsts)
    )
    length = draw(st.sampled_from((8, *LONGER)))
    message = Message(f"{prefix}All", extended | first_id, length, kind != "together", signals, kind == "nested")
    return [(message, signal) for signal in signals]


@st.composite
def dbc_files(draw: st.DrawFn) -> Drawn:
    """A file with positions and torques of one to three axes, and much that nobody binds."""
    n_axes = draw(st.integers(1, 3))
    position = draw(messages("Told", n_axes, 0x300))
    torque = draw(messages("Asked", n_axes, 0x200))
    used = dict.fromkeys(message for message, _ in [*torque, *position])
    text = 'VERSION ""\n\nNS_ :\n\nBS_:\n\nBU_: Host Drive Other\n\n' + "\n".join(message.text for message in used)
    text += draw(st.sampled_from(["", NOISE, NOISE + LONG]))
    text += '\nCM_ "\xb0C and \xb5m";\n'
    text += "".join(message.about for message in used)
    rated = 5.0
    binding = {
        "position": [{"message": m.name, "signal": s.name, "scale": 100.0} for m, s in position],
        "torque": [
            {
                "message": m.name,
                "signal": s.name,
                "scale": 1.0 if s.is_float else rated / s.factor / ((1 << (s.length - 1)) - 4),
            }
            for m, s in torque
        ],
    }
    return Drawn(text, binding, position, torque, n_axes)
