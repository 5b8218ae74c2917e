"""Digital inputs of moteus controllers: pins that are asked for with every command."""

import tomllib
from typing import Any

import pytest

from drivers.families.moteus.config import MoteusInput
from drivers.families.moteus.inputs import Pins
from drivers.families.moteus.registers import REPLY, Register, Type, Value
from drivers.protocols.base import DriveStatus, LayoutError
from hil.rig.layout import host_layout
from hil.rig.schema import RigConfig
from hil.virtual.lockstep import LockstepRun
from tests.support.paths import RIGS
from tests.support.switch_run import assert_switch_stops

ALL_WIRED = DriveStatus.LIMIT_LOW | DriveStatus.LIMIT_HIGH | DriveStatus.HOME
WIRED = [{"axis": 0, "input": "limit_low", "pin": 1}, {"axis": 0, "input": "limit_high", "pin": 2}]


def rig_of(inputs: list[dict[str, Any]], direction: int = 1) -> RigConfig:
    document: Any = tomllib.loads((RIGS / "moteus.toml").read_text())
    document["bus"]["moteus"]["inputs"] = inputs
    document["axes"]["x"]["direction"] = direction
    document["axes"]["x"]["limits"]["switches"] = True
    document["plant"]["switches"] = [{"axis": "x", "low": -0.02, "high": 0.02}]
    document["plant"]["drive"]["turn"][0] *= direction
    return RigConfig.model_validate(document)


@pytest.mark.parametrize("direction", [1, -1])
def test_an_axis_that_runs_onto_a_switch_is_stopped(direction: int) -> None:
    run = LockstepRun(rig_of(WIRED, direction), RIGS)
    assert_switch_stops(run)


@pytest.mark.parametrize(
    ("first", "second", "status"),
    [
        (0, 1, 0),
        (1, 1, DriveStatus.LIMIT_LOW),
        (0b10000, 1, DriveStatus.LIMIT_HIGH),
        (0, 0, DriveStatus.HOME),
        (0b10001, 0b11110, ALL_WIRED),
    ],
)
def test_a_pin_is_a_bit_of_its_connector(first: int, second: int, status: int) -> None:
    entries = [
        MoteusInput(axis=0, input="limit_low", pin=1),
        MoteusInput(axis=0, input="limit_high", pin=5),
        MoteusInput(axis=0, input="home", aux=2, pin=1, closed=0),
    ]
    pins = Pins(entries)
    told = {
        int(register): Value(REPLY, register, Type.INT8, raw)
        for register, raw in ((Register.AUX1_GPIO_STATUS, first), (Register.AUX2_GPIO_STATUS, second))
    }
    assert pins.status(told) == status
    assert pins.status(dict(list(told.items())[:1])) == -1
    assert (pins.tells, pins.answer_length, len(pins.query)) == (ALL_WIRED, 6, 4)
    said = {register: Value(REPLY, register, kind, raw) for register, kind, raw in pins.parts(status)}
    assert pins.status(said) == status


@pytest.mark.parametrize(
    ("inputs", "says"),
    [
        ([], "no bit for LIMIT_LOW|LIMIT_HIGH, which axes.x.limits.switches = true needs"),
        ([WIRED[0]], "no bit for LIMIT_HIGH"),
        ([*WIRED, {**WIRED[0], "axis": 2}], "bus.moteus.inputs[2].axis = 2: 0 to 1 are there"),
        ([*WIRED, WIRED[1]], "bus.moteus.inputs[2]: limit_high of axis 0 is bound twice"),
    ],
)
def test_what_cannot_be_meant_is_refused(inputs: list[dict[str, Any]], says: str) -> None:
    with pytest.raises(LayoutError) as caught:
        host_layout(rig_of(inputs), RIGS)
    assert says in str(caught.value)


def test_the_frames_are_as_long_as_the_bus_load_says() -> None:
    lengths: set[tuple[int, int]] = set()
    run = LockstepRun(
        rig_of(WIRED),
        RIGS,
        observer=lambda tick, frames, result: lengths.update(
            (frame.can_id, len(frame.data)) for frame in (*frames, *result.frames)
        ),
    )
    for _ in range(300):
        run.tick()
    allowed = {message.can_id: (message.length, *message.also) for message in run.cycle.protocol.messages(1_000_000)}
    assert all(length <= max(allowed[can_id]) for can_id, length in lengths)
    assert {can_id for can_id, _ in lengths} == set(allowed)
