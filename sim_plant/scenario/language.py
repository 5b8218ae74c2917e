"""Scripted misbehaviour of the emulated stage and of its bus: a small language in TOML, usable from Python alike.

    [[fault]]
    kind = "encoder_jump"     # what; see KINDS
    axis = "x"                # whose; without it: every axis; of the kinds sensor_...: sensor = "force", or every one
    at_phase = "dwell"        # when: at_s, at_tick, at_state or at_phase (the latter two with after_s, occurrence)
    duration_ticks = 3        # how long: duration_s or duration_ticks; without: until the end of the run
    value = 5e-6              # how much, in the unit KINDS gives

Kinds named plant_... step a key of [plant] to value, and back at their end. Kinds named wire_... go to
drivers/wire/wire.py (FaultKind there explains them) and take its keys: node, receiver, can_id, count, delay_s, bit,
period_s, length. Faults begin and end at their exact instants; everything random comes from `seed`.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, NamedTuple

from pydantic import Field, ValidationError, model_validator

from drivers.base.keys import Table
from drivers.base.text_file import words_of
from drivers.base.toml_file import TomlError, first_problems, own_words, read_toml, short, shown
from drivers.protocols.base import DriveStatus
from drivers.wire.faults import FOREVER_NS, FaultKind, WireFault

WIRE_PREFIX = "wire_"
SENSOR_PREFIX = "sensor_"
_WIRE_KEYS = ("node", "receiver", "can_id", "count", "delay_s", "bit", "period_s", "length")
_LONGEST = 400  # characters of one problem's text
_TRIGGERS = ("at_s", "at_tick", "at_state", "at_phase")


class Kind(NamedTuple):
    """What a kind does; `value`'s unit ("": takes none), its default (None: must be given) and allowed range.

    shows: DriveStatus bits that the drive tells as long as it lasts; such a kind needs nothing in injector.py.
    """

    text: str
    unit: str = ""
    default: float | None = None
    low: float = 0.0
    high: float = 0.0
    shows: int = 0


KINDS: dict[str, Kind] = {
    "encoder_silent": Kind("the drive does not answer"),
    "encoder_stuck": Kind("the count stays where it is"),
    "encoder_jump": Kind("the count is off by value", "m or rad", None, -1e3, 1e3),
    "encoder_glitch": Kind("single counts are off by value, with `probability` each", "m or rad", None, -1e3, 1e3),
    "encoder_noise": Kind("uniform noise within +-value on every count", "m or rad", None, 0.0, 1e3),
    "encoder_extreme": Kind("the most negative count there is: what a NaN becomes in an integer"),
    "encoder_fault": Kind("the drive says that its encoder cannot be trusted", shows=DriveStatus.ENCODER_FAULT),
    "limit_switch": Kind("a limit switch closes: value -1 the low one, 1 the high one", "side", 1.0, -1.0, 1.0),
    "drive_fault": Kind("the drive finds a fault and latches it; for the duration it comes back after every reset"),
    "drive_watchdog": Kind("the drive's watchdog trips"),
    "wrong_sequence": Kind("answers carry a sequence number off by value", "counts", 1.0, -65535, 65535),
    "bad_checksum": Kind("one payload bit is wrong, with `probability` per frame; the CAN CRC is right"),
    "garbage": Kind("random payload bytes"),
    "stale_feedback": Kind("answers repeat those of value ticks before", "ticks", 3.0, 1, 1000),
    "duplicate_feedback": Kind("every answer comes twice"),
    "reordered_feedback": Kind("answers of neighbouring ticks swap places"),
    "clock_jump": Kind("the drive's clock is off by value", "s", None, -1.0, 1.0),
    "torque_constant": Kind("force is value times what was asked for", "ratio", None, -2.0, 10.0),
    "axis_jam": Kind("value of additional dry friction", "N or N m", 1e4, 0.0, 1e9),
    "push": Kind("an external force", "N or N m", None, -1e6, 1e6),
}
KINDS |= {
    SENSOR_PREFIX + "silent": Kind("the sensor sends nothing"),
    SENSOR_PREFIX + "stuck": Kind("the reading stays where it is"),
    SENSOR_PREFIX + "value": Kind("the reading is value", "the sensor's unit", None, -1e9, 1e9),
    SENSOR_PREFIX + "invalid": Kind("the sensor says that its reading is not valid"),
    SENSOR_PREFIX + "sequence": Kind("the sensor's sequence numbers are off by value", "samples", 7.0, -255, 255),
}
PLANT_PREFIX = "plant_"
_TO = "from then on is value"
KINDS |= {
    PLANT_PREFIX + name: Kind(text, unit, None, low, high)
    for name, text, unit, low, high in (
        ("presliding", f"Coulomb friction over its stiffness at rest {_TO}", "m or rad", 0.0, 1e-2),
        ("presliding_damping", f"the stuck axis' damping ratio {_TO}", "ratio", 0.0, 2.0),
        ("torque_lag", f"the force's time constant {_TO}", "s", 0.0, 0.1),
        ("torque_noise", f"the force's noise {_TO}", "N/sqrt(Hz)", 0.0, 1.0),
        ("mode_frequency", f"the frequency of the axis' mode {_TO} (without one: of a new one)", "Hz", 10.0, 2000.0),
        ("mode_damping", f"the damping ratio of its mode {_TO}", "ratio", 0.0, 1.0),
        ("mode_load", f"the tool's part of the mass {_TO}", "ratio", 0.0, 0.9),
        ("friction_variation", f"the fraction by which friction varies {_TO}", "ratio", 0.0, 0.95),
        ("friction_period", f"the travel after which that repeats {_TO}", "m or rad", 1e-6, 1e2),
        ("friction_phase", f"its phase at position 0 {_TO}", "rad", -1e3, 1e3),
        ("cogging", f"the amplitude of the axis' first cogging harmonic {_TO}", "N or N m", 0.0, 1e2),
        ("cogging_period", f"the travel after which that harmonic repeats {_TO}", "m or rad", 1e-6, 1e2),
        ("cogging_phase", f"its phase at position 0 {_TO}", "rad", -1e3, 1e3),
        ("cable_stiffness", f"the cables' stiffness {_TO}", "N/m", 0.0, 1e4),
        ("cable_hysteresis", f"half the width of the cables' loop {_TO}", "N or N m", 0.0, 1e2),
        ("cable_reach", f"the travel over which that force turns round {_TO}", "m or rad", 1e-9, 1e2),
        ("bias", f"a constant force {_TO}", "N or N m", -1e2, 1e2),
        ("bias_walk", f"the walk of that force {_TO}", "N/sqrt(s)", 0.0, 1e2),
        ("vibration", f"the floor's acceleration on the axis {_TO}, at its first line's frequency", "m/s^2", 0.0, 1e2),
        ("vibration_frequency", f"the frequency of that line {_TO}", "Hz", 1e-3, 5e3),
        ("backlash", f"the lost motion of the tool {_TO}", "m or rad", 0.0, 1e-2),
        ("drift", f"the thermal drift of the tool {_TO}, counted from the start", "m/s", -1e-3, 1e-3),
        ("encoder_noise", f"the RMS noise of every sample {_TO}", "m or rad", 0.0, 1e-3),
        ("encoder_periodic_error", f"the error within a signal period {_TO}", "m or rad", 0.0, 1e-3),
        ("encoder_period", f"that signal period {_TO}", "m or rad", 1e-9, 1.0),
        ("encoder_latency", f"the unknown age of a sample {_TO}", "s", 0.0, 1e-3),
    )
}
KINDS |= {WIRE_PREFIX + kind.value: Kind(f"see FaultKind.{kind.name} in drivers/wire/faults.py") for kind in FaultKind}

MOST_FAULTS = 1000  # of one scenario
Positive = Annotated[float, Field(gt=0, le=1e6)]
Seconds = Annotated[float, Field(ge=0, le=1e6)]
Count = Annotated[int, Field(ge=0, le=10**9)]


class FaultConfig(Table):
    """One [[fault]]."""

    kind: str
    axis: str | None = None
    sensor: str | None = None
    at_s: Seconds | None = None
    at_tick: Count | None = None
    at_state: str | None = None
    at_phase: str | None = None
    after_s: Seconds = 0.0  # from the beginning of the state or phase
    occurrence: Annotated[int, Field(ge=1, le=1_000_000)] = 1  # of the state or phase, counted from the run's start
    duration_s: Positive | None = None
    duration_ticks: Annotated[int, Field(ge=1, le=10**9)] | None = None
    value: float | None = None
    probability: Annotated[float, Field(gt=0, le=1)] = 1.0
    seed: Annotated[int, Field(ge=0, lt=2**32)] = 1
    node: str | None = None
    receiver: str | None = None
    can_id: Annotated[int, Field(ge=0, lt=2**32)] | None = None
    count: Annotated[int, Field(ge=0, le=2**31)] | None = None
    delay_s: Seconds | None = None
    bit: Annotated[int, Field(ge=-1, le=1000)] | None = None
    period_s: Positive | None = None
    length: Annotated[int, Field(ge=0, le=8)] | None = None

    @property
    def on_wire(self) -> bool:
        """Whether drivers/wire/wire.py carries it out."""
        return self.kind.startswith(WIRE_PREFIX)

    @property
    def amount(self) -> float:
        """`value`, or the kind's default."""
        default = KINDS[self.kind].default
        return self.value if self.value is not None else (default or 0.0)

    @model_validator(mode="after")
    def _consistent(self) -> "FaultConfig":
        problems = _problems(self)
        if problems:
            raise ValueError("; ".join(problems))
        return self


def _problems(fault: FaultConfig) -> list[str]:
    if fault.kind not in KINDS:
        return [f"kind = '{fault.kind}': not known; allowed: {', '.join(KINDS)}"]
    problems = []
    given = [key for key in _TRIGGERS if getattr(fault, key) is not None]
    if len(given) != 1:
        problems.append(f"needs exactly one of {', '.join(_TRIGGERS)}; has {', '.join(given) or 'none'}")
    if fault.duration_s is not None and fault.duration_ticks is not None:
        problems.append("has both duration_s and duration_ticks; at most one is allowed")
    if given and given[0] in ("at_s", "at_tick") and (fault.after_s or fault.occurrence != 1):
        problems.append(f"after_s and occurrence belong to at_state and at_phase, not to {given[0]}")
    return problems + _value_problems(fault) + _owner_problems(fault) + _wire_problems(fault)


def _owner_problems(fault: FaultConfig) -> list[str]:
    of_sensor = fault.kind.startswith(SENSOR_PREFIX)
    if of_sensor and fault.axis is not None:
        return [f"axis = '{fault.axis}': kind '{fault.kind}' takes `sensor` instead"]
    if fault.sensor is not None and not of_sensor:
        return [f"sensor = '{fault.sensor}': of the {SENSOR_PREFIX}... kinds alone, not of '{fault.kind}'"]
    return []


def _value_problems(fault: FaultConfig) -> list[str]:
    kind = KINDS[fault.kind]
    if fault.value is None:
        needed = kind.unit and kind.default is None
        return [f"kind = '{fault.kind}' needs value ({kind.unit}, {kind.low:g} to {kind.high:g})"] if needed else []
    if not kind.unit:
        return [f"value = {fault.value}: kind '{fault.kind}' takes none"]
    if not kind.low <= fault.value <= kind.high:
        return [f"value = {fault.value}: allowed {kind.low:g} to {kind.high:g} ({kind.unit})"]
    return []


def _wire_problems(fault: FaultConfig) -> list[str]:
    stray = [key for key in _WIRE_KEYS if getattr(fault, key) is not None]
    if not fault.on_wire:
        return [f"{key} belongs to the wire_... kinds, not to '{fault.kind}'" for key in stray]
    if fault.axis is not None:
        return [f"axis = '{fault.axis}': the wire_... kinds take `node` (an axis' name, or 'host') instead"]
    try:
        wire_fault(fault, 0, FOREVER_NS)
    except ValueError as error:
        return [str(error)]
    return []


def wire_fault(fault: FaultConfig, from_ns: int, until_ns: int) -> WireFault:
    """The fault in the terms of drivers/wire/wire.py. Raises ValueError naming key, value and allowed range."""
    kind = FaultKind(fault.kind.removeprefix(WIRE_PREFIX))
    given = {key: getattr(fault, key) for key in ("node", "receiver", "can_id", "count", "bit", "length")}
    times = {"delay_ns": fault.delay_s, "period_ns": fault.period_s}
    given |= {key: round(value * 1e9) for key, value in times.items() if value is not None}
    arguments = {key: value for key, value in given.items() if value is not None}
    return WireFault(kind, from_ns, until_ns, probability=fault.probability, **arguments)


class Scenario(Table):
    """A whole scenario file."""

    description: str = ""
    fault: Annotated[list[FaultConfig], Field(max_length=MOST_FAULTS)] = []  # noqa: RUF012  # pydantic copies it

    def check(
        self,
        axis_names: Sequence[str],
        states: Sequence[str] = (),
        phases: Sequence[str] = (),
        sensors: Sequence[str] = (),
    ) -> None:
        """Raise ScenarioError for a name that the rig does not have; states or phases empty: not checked."""
        nodes = [*axis_names, *sensors, "host", "drives"]
        problems = []
        for number, fault in enumerate(self.fault):
            known = (
                ("axis", fault.axis, axis_names),
                ("at_state", fault.at_state, states),
                ("at_phase", fault.at_phase, phases),
                ("node", fault.node if fault.kind != "wire_babble" else None, nodes),
                ("receiver", fault.receiver, nodes),
            )
            problems += [
                f"fault {number + 1}: {key} = '{name}': not known; allowed: {', '.join(names)}"
                for key, name, names in known
                if name is not None and names and name not in names
            ]
            if fault.kind.startswith(SENSOR_PREFIX) and (not sensors or fault.sensor not in (None, *sensors)):
                there = ", ".join(sensors) or "none: the rig has no [sensors]"
                named = "" if fault.sensor is None else f"sensor = '{fault.sensor}': not known; "
                problems.append(f"fault {number + 1}: {named}kind = '{fault.kind}' needs a sensor; there are: {there}")
        if problems:
            raise ScenarioError(first_problems(problems, str))


class ScenarioError(ValueError):
    """A scenario that cannot be used; `problems` holds one line per problem."""

    def __init__(self, problems: Sequence[str]) -> None:
        super().__init__("\n".join(problems))
        self.problems = list(problems)


def load_scenario(path: Path) -> Scenario:
    """Read a scenario file. Raises ScenarioError with every problem."""
    try:
        return Scenario.model_validate(read_toml(path))
    except OSError as error:
        raise ScenarioError([f"{path}: {words_of(error)}"]) from None
    except TomlError as error:
        raise ScenarioError([f"{path}: {error}"]) from None
    except ValidationError as error:
        lines = first_problems(error.errors(include_url=False), _describe)
        raise ScenarioError([f"{path}: {line}" for line in lines]) from None


def _describe(error: dict[str, Any]) -> str:
    """A line for one of pydantic's errors; faults are numbered from 1."""
    path = [str(part + 1) if isinstance(part, int) else short(part) for part in error["loc"]]
    value = error["input"]
    given = "" if isinstance(value, dict) else f" = {shown(value)}"
    return f"{'.'.join(path) or 'scenario'}{given}: {short(own_words(error['msg']), _LONGEST)}"
