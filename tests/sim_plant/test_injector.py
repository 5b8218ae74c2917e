"""Fault scenarios: each kind does what it says, at its instant, on its axis; and nothing wrong is let through."""

import contextlib
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from drivers.config import BusConfig, WireConfig
from drivers.frame import Frame
from drivers.protocols import host_protocol
from drivers.protocols.base import Command, DriveStatus, Reject, Sample
from drivers.wire.wire import Wire
from sim_plant.config import PlantConfig
from sim_plant.emulator import EmulatedStage
from sim_plant.scenario.injector import Injector
from sim_plant.scenario.language import KINDS, FaultConfig, Scenario, ScenarioError, load_scenario

MS = 1_000_000
AXES = ["x", "y"]
PLANT = PlantConfig(
    mass=[0.5, 0.5], coulomb=[0.1, 0.1], viscous=[1.0, 1.0], quadratic=[0.0, 0.0], encoder_resolution=1e-8
)


class Rig:
    """A stage commanded once a millisecond; what a tick brings back, by axis."""

    def __init__(self, *faults: dict[str, Any], force: float = 0.0) -> None:
        bus = BusConfig()
        self.host = host_protocol(bus, 2, [5.0, 5.0], Path())
        self.stage = EmulatedStage(PLANT, bus, AXES, [5.0, 5.0], Path())
        self.injector = Injector(Scenario.model_validate({"fault": list(faults)}), self.stage, None, MS)
        self.force = force
        self.index = 0

    def tick(self, *, reset: bool = False) -> dict[int, list[Sample | Reject]]:
        self.index += 1
        command = self.host.encode(Command(self.index, [self.force, self.force], 3, reset))[0]
        answers = self.stage.on_frame(command._replace(timestamp_ns=self.index * MS))
        got: dict[int, list[Sample | Reject]] = {0: [], 1: []}
        for answer in answers:
            axis = AXES.index(self.stage.sender_of(answer))
            got[axis].append(self.host.decode(answer._replace(timestamp_ns=self.index * MS)))
        return got

    def axis(self, axis: int) -> list[Sample]:
        return [item for item in self.tick()[axis] if isinstance(item, Sample)]


def during(kind: str, **keys: Any) -> dict[str, Any]:
    """A fault on x from just before tick 3 for two ticks."""
    return {"kind": kind, "axis": "x", "at_s": 0.0025, "duration_ticks": 2, **keys}


def test_an_encoder_is_silent_from_its_instant_for_its_duration_on_its_axis() -> None:
    rig = Rig(during("encoder_silent"))
    counts = [{axis: len(items) for axis, items in rig.tick().items()} for _ in range(5)]
    assert [count[0] for count in counts] == [1, 1, 0, 0, 1]
    assert [count[1] for count in counts] == [1, 1, 1, 1, 1]


def test_without_an_axis_every_axis_has_the_fault_and_without_a_duration_it_lasts() -> None:
    rig = Rig({"kind": "encoder_silent", "at_tick": 2})
    assert [sum(map(len, rig.tick().values())) for _ in range(5)] == [2, 0, 0, 0, 0]


def test_a_stuck_encoder_moves_on_when_the_fault_ends() -> None:
    rig = Rig(during("encoder_stuck"), force=2.0)
    seen = [rig.axis(0)[0].position for _ in range(5)]
    assert seen[1] <= seen[2] == seen[3] < seen[4]
    assert seen[4] == pytest.approx(rig.stage.sampled[0][0] / 1e-8, abs=0.51)


@pytest.mark.parametrize(
    ("kind", "keys", "change"),
    [
        ("encoder_jump", {"value": 5e-6}, lambda sample: sample.position == 500),
        ("encoder_glitch", {"value": -5e-6}, lambda sample: sample.position == -500),
        ("encoder_extreme", {}, lambda sample: sample.position == -(1 << 31)),
        ("encoder_fault", {}, lambda sample: bool(sample.status & DriveStatus.ENCODER_FAULT)),
        ("wrong_sequence", {"value": 7}, lambda sample: sample.sequence in (10, 11)),
        ("clock_jump", {"value": 0.25}, lambda sample: sample.stamp_ns % MS == 0 and sample.stamp_ns >= 250 * MS),
    ],
)
def test_a_sample_is_falsified_during_the_fault_only(
    kind: str, keys: dict[str, Any], change: Callable[[Sample], bool]
) -> None:
    rig = Rig(during(kind, **keys))
    assert [change(rig.axis(0)[0]) for _ in range(5)] == [False, False, True, True, False]
    assert not change(rig.axis(1)[0])


def test_noise_is_bounded_seeded_and_different_per_axis() -> None:
    def counts(seed: int) -> list[tuple[int, int]]:
        rig = Rig({"kind": "encoder_noise", "at_s": 0.0, "value": 1e-7, "seed": seed})
        ticks = [rig.tick() for _ in range(200)]
        return [(tick[0][0].position, tick[1][0].position) for tick in ticks]  # type: ignore[union-attr]

    first = counts(1)
    assert counts(1) == first != counts(2)
    assert {abs(x) for x, _ in first} == set(range(11))
    assert any(x != y for x, y in first)


@pytest.mark.parametrize(("kind", "reason"), [("bad_checksum", Reject.BAD_CHECKSUM), ("garbage", Reject.BAD_CHECKSUM)])
def test_damaged_payloads_are_rejected_by_the_layout(kind: str, reason: Reject) -> None:
    rig = Rig(during(kind))
    assert [rig.tick()[0] == [reason] for _ in range(5)] == [False, False, True, True, False]


def test_stale_duplicate_and_reordered_answers_show_in_their_sequence_numbers() -> None:
    def sequences(kind: str) -> list[list[int]]:
        rig = Rig({"kind": kind, "axis": "x", "at_tick": 2})
        return [[sample.sequence for sample in rig.axis(0)] for _ in range(7)]

    assert sequences("stale_feedback") == [[1], [2], [2], [2], [2], [3], [4]]
    assert sequences("duplicate_feedback") == [[1], [2, 2], [3, 3], [4, 4], [5, 5], [6, 6], [7, 7]]
    assert sequences("reordered_feedback") == [[1], [], [3, 2], [], [5, 4], [], [7, 6]]


def test_a_drive_fault_without_a_duration_is_cleared_by_a_reset_and_with_one_comes_back() -> None:
    once, lasting = Rig({"kind": "drive_fault", "axis": "x", "at_tick": 2}), Rig(during("drive_fault"))
    for rig in (once, lasting):
        rig.tick()
        rig.tick()
        rig.tick()
        assert rig.stage.drives[0].status & DriveStatus.FAULT
        rig.tick(reset=True)
    assert not once.stage.drives[0].status & DriveStatus.FAULT
    assert lasting.stage.drives[0].status & DriveStatus.FAULT
    lasting.tick()
    lasting.tick(reset=True)
    assert not lasting.stage.drives[0].status & DriveStatus.FAULT


def test_a_drive_watchdog_can_be_made_to_trip() -> None:
    rig = Rig({"kind": "drive_watchdog", "axis": "y", "at_s": 0.0025}, force=1.0)
    for _ in range(4):
        rig.tick()
    assert [drive.force for drive in rig.stage.drives] == [1.0, 0.0]
    assert rig.stage.drives[1].trips[0].expired_ns == 2_500_000


def test_force_faults_act_on_physics() -> None:
    def moved(force: float, *faults: dict[str, Any]) -> float:
        rig = Rig(*faults, force=force)
        for _ in range(20):
            rig.tick()
        return float(rig.stage.position[0])

    healthy = moved(2.0)
    assert healthy > 0
    assert moved(2.0, {"kind": "axis_jam", "axis": "x", "at_s": 0.0}) == 0.0
    assert moved(2.0, {"kind": "torque_constant", "axis": "x", "at_s": 0.0, "value": -1.0}) == pytest.approx(-healthy)
    assert moved(0.0, {"kind": "push", "axis": "x", "at_s": 0.001, "value": 2.0}) == pytest.approx(healthy)


def test_a_fault_waits_for_the_second_dwell_and_then_some() -> None:
    fault = {"kind": "encoder_silent", "axis": "x", "at_phase": "dwell", "occurrence": 2, "after_s": 0.001}
    rig = Rig(fault)
    answered = []
    for phase in ("approach", "dwell", "move", "dwell", "dwell", "dwell"):
        answered.append(len(rig.tick()[0]))
        rig.injector.observe(rig.stage.now_ns, "ACTIVE", phase)
    assert answered == [1, 1, 1, 1, 0, 0]
    assert rig.injector.began[0][0] == 5 * MS


def test_wire_kinds_reach_the_wire_and_are_refused_without_one() -> None:
    bus = BusConfig()
    wire = Wire.from_config(bus, WireConfig())
    heard: list[Frame] = []
    wire.attach("host", heard.append)
    node = wire.attach("x", None)
    stage = EmulatedStage(PLANT, bus, AXES, [5.0, 5.0], Path())
    fault = {"kind": "wire_drop", "at_tick": 1, "duration_ticks": 1, "node": "x", "receiver": "host"}
    Injector(Scenario.model_validate({"fault": [fault]}), stage, wire, MS)
    for k in range(3):
        node.send(Frame(0x100, bytes(8)), k * MS)
        wire.advance((k + 1) * MS)
    assert [frame.timestamp_ns // MS for frame in heard] == [0, 2]
    with pytest.raises(ValueError, match="only a simulated wire"):
        Rig(fault)


@pytest.mark.parametrize(
    ("keys", "said"),
    [
        ({"kind": "encoder_wobble", "at_s": 0}, "kind = 'encoder_wobble': not known; allowed: encoder_silent"),
        ({"kind": "push", "at_s": 0}, "needs value"),
        ({"kind": "push", "at_s": 0, "value": 1e9}, "allowed -1e+06 to 1e+06"),
        ({"kind": "garbage", "at_s": 0, "value": 1}, "takes none"),
        ({"kind": "garbage"}, "needs exactly one of at_s, at_tick, at_state, at_phase; has none"),
        ({"kind": "garbage", "at_s": 0, "at_tick": 1}, "has at_s, at_tick"),
        ({"kind": "garbage", "at_s": 0, "after_s": 1}, "belong to at_state and at_phase"),
        ({"kind": "garbage", "at_s": 0, "duration_s": 1, "duration_ticks": 1}, "at most one"),
        ({"kind": "garbage", "at_s": 0, "node": "x"}, "node belongs to the wire"),
        ({"kind": "wire_drop", "at_s": 0, "axis": "x"}, "take `node`"),
        ({"kind": "wire_bus_off", "at_s": 0}, "a node's name is needed"),
        ({"kind": "garbage", "at_s": float("nan")}, "finite"),
        ({"kind": "garbage", "at_s": 0, "colour": "red"}, "Extra inputs"),
    ],
)
def test_a_fault_that_makes_no_sense_is_refused_with_the_reason(keys: dict[str, Any], said: str) -> None:
    with pytest.raises(ValidationError) as caught:
        FaultConfig.model_validate(keys)
    assert said in str(caught.value)


def test_names_the_rig_does_not_have_are_all_reported(tmp_path: Path) -> None:
    path = tmp_path / "scenario.toml"
    path.write_text(
        '[[fault]]\nkind = "garbage"\naxis = "q"\nat_state = "ACTIV"\n'
        '[[fault]]\nkind = "wire_down"\nnode = "hast"\nat_s = 1\n'
    )
    with pytest.raises(ScenarioError) as caught:
        load_scenario(path).check(AXES, ["ACTIVE"], ["dwell"])
    assert [problem.split(":")[0] for problem in caught.value.problems] == ["fault 1", "fault 1", "fault 2"]
    assert "allowed: ACTIVE" in str(caught.value)


def test_every_kind_can_be_begun_and_ended() -> None:
    for kind, meaning in KINDS.items():
        if not kind.startswith(("wire_", "sensor_")):  # those are begun and ended in tests/virtual/test_sensors.py
            value = {"value": min(max(0.5, meaning.low), meaning.high)} if meaning.unit else {}
            rig = Rig(during(kind, **value), force=0.5)
            for _ in range(6):
                rig.tick()
            assert len(rig.injector.began) == 1
            assert not rig.stage.frame_taps
            assert not rig.stage.drives[0].taps


@given(st.text(max_size=200))
def test_any_text_is_a_scenario_or_a_clear_refusal(text: str) -> None:
    try:
        document = tomllib.loads(text)
    except tomllib.TOMLDecodeError:
        return
    with contextlib.suppress(ValidationError):
        Scenario.model_validate(document)


values = st.one_of(
    st.integers(-5, 5), st.floats(allow_nan=True), st.sampled_from(["x", "dwell", *KINDS]), st.booleans()
)


@given(st.dictionaries(st.sampled_from([*FaultConfig.model_fields]), values, max_size=6), st.sampled_from([*KINDS]))
def test_any_keys_make_a_fault_that_runs_or_a_clear_refusal(keys: dict[str, Any], kind: str) -> None:
    document = {"fault": [{"at_tick": 1, **keys, "kind": kind}]}
    try:
        scenario = Scenario.model_validate(document)
        scenario.check(AXES)
    except (ValidationError, ScenarioError):
        return
    stage = EmulatedStage(PLANT, BusConfig(), AXES, [5.0, 5.0], Path())
    wire = Wire.from_config(BusConfig(), WireConfig())
    for name in ("host", "drives", *AXES):
        wire.attach(name, None)
    Injector(scenario, stage, wire, MS)
    stage.advance(3 * MS)
    wire.advance(3 * MS)


def test_a_step_of_the_plants_bias_moves_its_axis_alone_and_ends() -> None:
    rig = Rig(during("plant_bias", value=1.0))
    velocities = []
    for _ in range(8):
        rig.tick()
        velocities.append(rig.stage.velocity.tolist())
    assert velocities[1][0] == 0.0
    assert velocities[3][0] == pytest.approx((1.0 - 0.1) / 0.5 * 1.5e-3, rel=0.01)
    assert velocities[7][0] < velocities[4][0]
    assert all(velocity[1] == 0.0 for velocity in velocities)
    assert rig.stage._stage.truth.bias.tolist() == [0.0, 0.0]


def test_steps_of_the_plants_structure_do_not_make_the_tool_jump() -> None:
    for kind, value in (("presliding", 1e-5), ("mode_frequency", 200.0), ("torque_lag", 1e-3), ("cogging", 0.05)):
        stepped, steady = Rig(during(f"plant_{kind}", value=value), force=1.0), Rig(force=1.0)
        for _ in range(8):
            before = stepped.stage.position[0]
            stepped.tick()
            steady.tick()
            moved = stepped.stage.position[0] - before
            assert -1e-9 < moved < 2e-3 * max(1e-3, abs(steady.stage.velocity[0]))
        assert stepped.stage.position[0] == pytest.approx(steady.stage.position[0], rel=0.3)
        assert stepped.stage._stage.truth.presliding.tolist() == [0.0, 0.0]


def test_a_step_of_encoder_latency_shows_the_axis_behind_where_it_is() -> None:
    late, steady = Rig(during("plant_encoder_latency", value=5e-4), force=1.0), Rig(force=1.0)
    shown = [(late.axis(0)[0].position, steady.axis(0)[0].position) for _ in range(6)]
    assert [a == b for a, b in shown] == [True, True, False, False, True, True]
    assert all(a <= b for a, b in shown)
