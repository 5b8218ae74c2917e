"""The gate between what a law asks for and what leaves the process."""

import ast
import math
import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.config import BusConfig
from drivers.frame import Frame
from drivers.protocols import device_protocol, host_protocol
from drivers.protocols.base import Command
from hil.cycle.gate import ForceLimits, TorqueGate, limit_force
from hil.virtual.batch import Bounds
from tests.support.paths import ROOT

LIMIT, STEP, LOW, HIGH = 5.0, 2.0, -1.0, 1.0
LIMITS = ForceLimits(LIMIT, LOW, HIGH, STEP)
BUS = BusConfig()
DEVICE = device_protocol(BUS, 2, [LIMIT, LIMIT], ROOT)


def make_gate() -> TorqueGate:
    return TorqueGate(host_protocol(BUS, 2, [LIMIT, LIMIT], ROOT), [LIMITS] * 2)


def applied(gate: TorqueGate, request: list[float], position: list[float], *, permitted: bool = True) -> Command:
    """The command as a drive would read it."""
    (frame,) = gate.release(request, position, permitted=permitted, sequence=7)
    command = DEVICE.decode_command(frame)
    assert isinstance(command, Command)
    return command


any_float = st.floats(allow_nan=True, allow_infinity=True, width=64)
near = st.floats(-1.5, 1.5)


@pytest.mark.requirement(id="SR-1.1")
@given(st.lists(any_float, min_size=2, max_size=2), st.lists(any_float, min_size=2, max_size=2), st.booleans())
def test_whatever_is_asked_the_force_is_finite_and_within_the_limit(
    request: list[float], position: list[float], permitted: bool
) -> None:
    command = applied(make_gate(), request, position, permitted=permitted)
    for force in command.force:
        assert math.isfinite(force)
        assert abs(force) <= STEP  # one tick from zero: the rate limit is the tighter bound
    if not permitted or not all(map(math.isfinite, request + position)):
        assert list(command.force) == [0.0, 0.0]
        assert command.enable == 0


@pytest.mark.requirement(id="SR-1.1")
@given(st.lists(st.tuples(st.floats(-20, 20), near), min_size=1, max_size=40))
def test_force_never_changes_faster_than_the_rate_limit_and_never_pushes_out_of_the_travel(
    steps: list[tuple[float, float]],
) -> None:
    gate = make_gate()
    previous = 0.0
    for request, position in steps:
        force = applied(gate, [request, 0.0], [position, 0.0]).force[0]
        assert abs(force) <= LIMIT
        if position >= HIGH:
            assert force <= 0.0
        if position <= LOW:
            assert force >= 0.0
        at_limit = (position >= HIGH and previous > 0) or (position <= LOW and previous < 0)
        if not at_limit:
            assert abs(force - previous) <= STEP * (1 + 1e-6)
        previous = gate.force[0]


@pytest.mark.parametrize(
    ("request_", "position", "expected"),
    [
        (1.0, 0.0, 1.0),  # inside every bound: untouched
        (2.0, 0.0, 2.0),  # exactly the rate limit
        (2.0 + 1e-9, 0.0, 2.0),
        (-2.5, 0.0, -2.0),
        (1.0, HIGH, 0.0),  # exactly at the limit: outward force is gone
        (1.0, math.nextafter(HIGH, 0), 1.0),
        (-1.0, HIGH, -1.0),  # inward force passes
        (-1.0, LOW, 0.0),
        (-1.0, math.nextafter(LOW, 0), -1.0),
        (1.0, LOW, 1.0),
        (-0.0, 0.0, 0.0),
    ],
)
def test_at_the_boundaries(request_: float, position: float, expected: float) -> None:
    assert applied(make_gate(), [request_, 0.0], [position, 0.0]).force[0] == expected


@given(st.lists(st.tuples(st.floats(-20, 20), st.floats(-5, 5), near), min_size=1, max_size=20))
def test_a_batch_of_plants_is_bounded_as_the_gate_bounds_one(cases: list[tuple[float, float, float]]) -> None:
    request, previous, position = (np.array(values)[:, None] for values in zip(*cases, strict=True))
    many = Bounds([LIMITS]).limit(request, previous, position)
    assert many[:, 0].tolist() == [limit_force(*case, LIMITS) for case in cases]


def test_the_limit_is_reached_in_steps_and_not_passed() -> None:
    gate = make_gate()
    forces = [applied(gate, [100.0, -100.0], [0.0, 0.0]).force for _ in range(4)]
    assert [f[0] for f in forces] == [2.0, 4.0, 5.0, 5.0]
    assert [f[1] for f in forces] == [-2.0, -4.0, -5.0, -5.0]
    assert gate.saturations == [4, 4]


def test_a_force_that_needs_no_change_is_not_counted_as_saturated() -> None:
    gate = make_gate()
    applied(gate, [1.0, -1.0], [0.0, 0.0])
    assert gate.saturations == [0, 0]


@pytest.mark.requirement(id="SR-1.1")
def test_without_permission_zero_comes_at_once_not_along_the_rate_limit() -> None:
    gate = make_gate()
    for _ in range(3):
        applied(gate, [5.0, 5.0], [0.0, 0.0])
    command = applied(gate, [5.0, 5.0], [0.0, 0.0], permitted=False)
    assert list(command.force) == [0.0, 0.0]
    assert command.enable == 0
    assert gate.force == [0.0, 0.0]
    assert applied(gate, [5.0, 5.0], [0.0, 0.0]).force[0] == STEP  # and it starts from zero again


def test_enable_goes_with_permission_and_covers_every_axis() -> None:
    assert applied(make_gate(), [0.0, 0.0], [0.0, 0.0]).enable == 0b11


def test_the_reset_bit_goes_out_only_with_zero_force() -> None:
    gate = make_gate()
    (frame,) = gate.zero(3, reset=True)
    command = DEVICE.decode_command(frame)
    assert isinstance(command, Command)
    assert (command.reset, list(command.force), command.enable, command.sequence) == (True, [0.0, 0.0], 0, 3)
    assert not applied(gate, [1.0, 1.0], [0.0, 0.0]).reset


class Listener:
    """A layout that keeps what the gate hands it, before any encoding can hide a mistake."""

    def __init__(self, n_axes: int) -> None:
        self.n_axes = n_axes
        self.heard: list[Command] = []

    def encode(self, command: Command) -> list[Frame]:
        self.heard.append(command._replace(force=list(command.force)))
        return []


def listened(n_axes: int = 2) -> tuple[TorqueGate, list[Command]]:
    """A gate, and all commands it gives from now on."""
    listener = Listener(n_axes)
    return TorqueGate(listener, [LIMITS] * n_axes), listener.heard  # type: ignore[arg-type]


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("where", ["request", "position"])
def test_one_value_that_is_no_number_disables_every_axis(value: float, axis: int, where: str) -> None:
    values = {"request": [1.0, 1.0], "position": [0.0, 0.0]}
    values[where][axis] = value
    gate, heard = listened()
    gate.release(**values, permitted=True, sequence=7)
    assert heard == [Command(7, [0.0, 0.0], 0, False)]
    assert gate.force == [0.0, 0.0]


@pytest.mark.parametrize("n_axes", [1, 2, 3, 4])
def test_the_command_enables_exactly_the_axes_there_are(n_axes: int) -> None:
    gate, heard = listened(n_axes)
    gate.release([1.0] * n_axes, [0.0] * n_axes, permitted=True, sequence=9)
    assert heard == [Command(9, [1.0] * n_axes, 2**n_axes - 1, False)]


def test_a_reset_is_sent_only_when_asked_for() -> None:
    gate, heard = listened()
    gate.zero(1)
    gate.release([0.0, 0.0], [0.0, 0.0], permitted=False, sequence=2)
    gate.release([0.0, 0.0], [0.0, 0.0], permitted=False, sequence=3, reset=True)
    gate.release([0.0, 0.0], [0.0, 0.0], permitted=True, sequence=4, reset=True)
    assert [command.reset for command in heard] == [False, False, True, False]


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_saturation_is_counted_on_the_axis_it_happens_to_in_either_direction(sign: float) -> None:
    gate, _ = listened()
    gate.release([sign * 3.0, 1.0], [0.0, 0.0], permitted=True, sequence=1)
    assert gate.saturations == [1, 0]


def test_permission_is_never_given_by_an_argument_in_the_wrong_place() -> None:
    gate, heard = listened()
    with pytest.raises(TypeError):
        gate.release([1.0, 1.0], [0.0, 0.0], True, 1)  # type: ignore[misc]
    assert heard == []


@pytest.mark.parametrize(("forces", "positions"), [(1, 2), (3, 2), (2, 1), (2, 3), (1, 1), (3, 3)])
def test_a_request_for_other_than_the_axes_there_are_is_an_error_and_nothing_goes_out(
    forces: int, positions: int
) -> None:
    gate, heard = listened()
    with pytest.raises(ValueError, match=f"^{forces} forces and {positions} positions for 2 axes$"):
        gate.release([1.0] * forces, [0.0] * positions, permitted=True, sequence=1)
    assert heard == []


@pytest.mark.requirement(id="SR-1.3")
def test_the_gate_knows_neither_laws_nor_trajectories() -> None:
    tree = ast.parse((ROOT / "hil/cycle/gate.py").read_text())
    imported = {node.module or "" for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)}
    assert imported <= {"collections.abc", "typing", "drivers.frame", "drivers.protocols.base"}


@pytest.mark.requirement(id="SR-1.3")
def test_nothing_else_in_hil_builds_a_command_frame() -> None:
    """By search: a Command is constructed, and a host protocol's encode called, in gate.py alone (benchmarks measure,
    they do not run rigs; the campaign puts another host on the simulated wire).
    """
    offenders = []
    for file in (ROOT / "hil").rglob("*.py"):
        path, text = str(file.relative_to(ROOT)), file.read_text()
        allowed = ("hil/cycle/gate.py", "hil/studies/fault_campaign/injections.py")
        if path in allowed or not re.search(r"\b(Command|encode)\b", text):
            continue
        for node in ast.walk(ast.parse(text)):
            if not isinstance(node, ast.Call):
                continue
            name = node.func.id if isinstance(node.func, ast.Name) else getattr(node.func, "attr", "")
            on_protocol = isinstance(node.func, ast.Attribute) and "protocol" in ast.unparse(node.func.value)
            if name == "Command" or (name == "encode" and on_protocol):
                offenders.append(f"{path}:{node.lineno}")
    assert offenders == []


# one axis and another ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("position", "expected"), [([0.0, HIGH], [1.0, 0.0]), ([HIGH, 0.0], [0.0, 1.0])])
def test_an_axis_at_its_end_takes_no_force_from_another(position: list[float], expected: list[float]) -> None:
    assert list(applied(make_gate(), [1.0, 1.0], position).force) == expected


def test_a_bound_is_of_its_axis_alone_never_above_the_limit_and_taken_back_whole() -> None:
    gate = make_gate()
    gate.bound(0, 0.5)
    for _ in range(3):
        applied(gate, [9.0, 9.0], [0.0, 0.0])
    assert gate.force == [0.5, LIMIT]
    gate.bound(0, math.inf)
    for _ in range(3):
        applied(gate, [9.0, 9.0], [0.0, 0.0])
    assert gate.force == [LIMIT, LIMIT]


@pytest.mark.parametrize(("low", "high", "least", "most"), [(True, False, 0.0, 1.0), (False, True, -1.0, 0.0)])
def test_a_closed_switch_takes_the_force_towards_it_and_gives_it_back(
    low: bool, high: bool, least: float, most: float
) -> None:
    for request, expected in ((-1.0, least), (1.0, most)):
        gate = make_gate()
        gate.block(0, low=low, high=high)
        assert list(applied(gate, [request, request], [0.0, 0.0]).force) == [expected, request]
        gate.block(0, low=False, high=False)
        assert list(applied(gate, [request, request], [0.0, 0.0]).force) == [request, request]
        assert list(applied(gate, [0.0, 0.0], [LOW - 1.0, HIGH + 1.0]).force) == [0.0, 0.0]
        assert applied(gate, [math.copysign(1.0, request)] * 2, [math.copysign(9.0, request)] * 2).force[0] == 0.0


def test_a_switch_that_closes_or_opens_leaves_the_bound_of_a_way_back() -> None:
    gate = make_gate()
    gate.bound(0, 0.5)
    for closed in (True, False):
        gate.block(0, low=closed, high=False)
        assert applied(gate, [1.0, 0.0], [0.0, 0.0]).force[0] == 0.5
