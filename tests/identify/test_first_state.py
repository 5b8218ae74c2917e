"""What identification lets a law begin with: friction as it turns, the force of each place, a file that a rig takes."""

from pathlib import Path

import numpy as np
import pytest
import tomlkit

from drivers.base.toml_file import toml_text
from hil.control.laws.position_table import NODES, PositionTable
from hil.control.laws.presliding_bank import slopes
from hil.control.laws.presliding_kalman import KEPT
from hil.identify.elements import Elements
from hil.identify.estimate import Array, Estimate
from hil.identify.findings import Findings
from hil.identify.first_state import first_state, with_first_state
from hil.identify.lockstep import identify
from hil.identify.travel_fit import TravelCurves
from hil.identify.written import rig_text
from hil.rig.file import load_rig, without_learnt
from hil.rig.schema import ModelConfig, RigConfig
from hil.virtual.batch import rig_law
from hil.virtual.sim import simulate
from tests.identify import rigs
from tests.support.paths import RIGS

FINEST, PITCH, COULOMB, MASS, TURNING = 0.3e-6, 1e-3, 0.6, 0.9, 0.25
REACHES = 1.0 / np.array(slopes(FINEST))
WAYS = np.geomspace(1e-7, 1e-4, 50)


def found(**values: float) -> dict[str, Estimate]:
    return {name: Estimate(value, 0.01 * value, "") for name, value in values.items()}


def state(
    estimates: dict[str, Estimate], elements: Elements | None = None, travel: TravelCurves | None = None
) -> list[float]:
    model = ModelConfig(mass=MASS, coulomb=COULOMB, viscous=3.0, gravity=-2.0)
    return first_state(estimates, elements, travel, model, turning=TURNING, finest=FINEST, pitch=PITCH)


def turned(weights: list[float]) -> Array:
    """By how much the law's friction has turned after these ways, N."""
    shares: Array = 2.0 * (1.0 - np.exp(-WAYS[:, None] / REACHES))
    whole: Array = shares @ np.array(weights)
    return whole


def test_a_bristle_as_long_as_an_operator_becomes_its_weight() -> None:
    weights = state(found(coulomb=0.7, presliding=REACHES[2]))[:7]
    assert weights == pytest.approx([0.0, 0.0, 0.7, 0.0, 0.0, 0.0, 0.0], abs=0.01)


@pytest.mark.parametrize("length", [0.5e-6, 1.4e-6, 12e-6, 30e-6])
def test_a_bristle_of_another_length_turns_as_it_does(length: float) -> None:
    whole = state(found(coulomb=0.7, presliding=length))
    assert len(whole) == KEPT
    assert sum(whole[:6]) == pytest.approx(0.7)
    truth = 1.4 * (1.0 - np.exp(-WAYS / length))
    assert np.abs(turned(whole[:6]) - truth).max() < 0.05 * 1.4
    assert whole[6:] == [0.0] * (KEPT - 6), "the model knows the mass; no travel was seen"


def test_a_damped_bristle_turns_as_in_a_motion_that_turns_round() -> None:
    """Its force is what the ODE gives: x = a t^2 / 2 from the reversal on."""
    length, time = 12e-6, 1.5e-3
    weights = state(found(coulomb=0.7, presliding=length, bristle_damping=0.7 * time))[:6]
    speed = np.sqrt(2.0 * TURNING * WAYS)
    bristle = 1.0 - 2.0 * np.exp(-WAYS / length)
    rate = speed / length * (1.0 - bristle)  # of LuGre's bristle, over its reach
    assert np.abs(turned(weights) - 0.7 * (bristle + time * rate + 1.0)).max() < 0.05 * 1.4


def test_damping_counts_up_to_that_of_an_axis_half_damped_on_its_bristle() -> None:
    """The loops of a short bristle show several times what it has."""
    length = 0.5e-6
    half = 0.7 * float(np.sqrt(MASS * length / 0.7))
    most = state(found(coulomb=0.7, presliding=length, bristle_damping=half))
    assert state(found(coulomb=0.7, presliding=length, bristle_damping=4.0 * half)) == pytest.approx(most)
    assert state(found(coulomb=0.7, presliding=length, bristle_damping=-half)) == state(
        found(coulomb=0.7, presliding=length)
    )
    assert most[:6] != pytest.approx(state(found(coulomb=0.7, presliding=length))[:6], rel=0.1)


def test_slip_elements_turn_as_they_do() -> None:
    lengths, limits = np.array([1e-6, 4e-6, 20e-6]), np.array([0.1, 0.3, 0.2])
    none = Estimate(0.0, 0.0, "")
    weights = state(found(coulomb=0.6), Elements(lengths, limits, none, none, none, 0.0))[:6]
    truth = np.array([(limits * np.minimum(way / lengths, 2.0)).sum() for way in WAYS])
    assert np.abs(turned(weights) - truth).max() < 0.08 * 1.2


def test_friction_of_which_nothing_is_known_at_rest_is_as_the_law_has_it_without() -> None:
    law = rig_law(load_rig(RIGS / "microscope.toml"))
    law.reset(np.zeros(4), np.zeros(4))
    fresh = np.array(law.learnt_state())[:, 0]
    assert state({}) == fresh.tolist()
    assert state(found(coulomb=0.7))[:7] == [0.0, 0.0, 0.0, 0.0, 0.7, 0.0, 0.0]


def tables(whole: list[float]) -> tuple[PositionTable, PositionTable]:
    """As the law has them, forwards and backwards."""
    both = PositionTable(PITCH, 10.0), PositionTable(PITCH, 10.0)
    both[0].fill(list(whole[7 : 7 + NODES]))
    both[1].fill(list(whole[7 + NODES : 7 + 2 * NODES]))
    return both


def travelled(position: Array) -> TravelCurves:
    """Friction that varies over 10 mm, and a weight of 2.1 N with a cable of 3 N/m."""
    friction = COULOMB * (1.0 + 0.1 * np.sin(2.0 * np.pi * position / 10e-3))
    return TravelCurves(position, friction, 2.1 + 3.0 * position, np.array([0.01]), np.array([COULOMB]), 0.0)


def test_the_tables_have_the_force_of_each_place_in_each_direction() -> None:
    forward, backward = tables(
        state(found(coulomb=COULOMB, presliding=5e-6), None, travelled(np.linspace(-0.018, 0.018, 240)))
    )
    for place in np.linspace(-0.0175, 0.0175, 30).tolist():
        varied = 0.1 * COULOMB * float(np.sin(2.0 * np.pi * place / 10e-3))
        assert float(forward.at(place)) == pytest.approx(0.1 + 3.0 * place + varied, abs=0.005)
        assert float(backward.at(place)) == pytest.approx(0.1 + 3.0 * place - varied, abs=0.005)
    assert float(forward.at(0.025)) == pytest.approx(float(forward.at(0.0181)), abs=1e-3), "held where nothing was seen"


def test_what_is_too_fine_for_the_tables_begins_the_waves() -> None:
    """And is in the tables no more; from four pitches on the tables have it."""
    position = np.linspace(-0.018, 0.018, 240)
    period, variation, phase = 0.9e-3, 0.1, 2.0
    friction = COULOMB * (1.0 + variation * np.sin(2.0 * np.pi * position / period + phase))
    travel = TravelCurves(position, friction, 0.0 * position - 2.0, *[np.ones(1)] * 2, 0.0)
    told = {"coulomb": COULOMB, "presliding": 5e-6, "friction_variation": variation, "friction_phase": phase}
    whole = state(found(**told, friction_period=period), None, travel)
    wave = [variation * COULOMB * np.cos(phase), variation * COULOMB * np.sin(phase)]
    assert whole[-4:] == pytest.approx([*wave, -wave[0], -wave[1]])
    coarse = state(found(**told, friction_period=4e-3), None, travel)
    assert coarse[-4:] == [0.0] * 4


def test_places_further_apart_than_the_nodes_are_joined() -> None:
    position = np.linspace(-0.03, 0.03, 13)  # every 5 mm
    whole = state(
        found(coulomb=COULOMB),
        None,
        TravelCurves(position, position * 0.0 + COULOMB, 2.0 + 3.0 * position, *[np.ones(1)] * 2, 0.0),
    )
    forward, _ = tables(whole)
    for place in (-0.0275, -0.012, 0.001, 0.0225):
        assert float(forward.at(place)) == pytest.approx(3.0 * place, abs=1e-3)


def test_the_law_goes_on_from_it() -> None:
    rig = load_rig(RIGS / "microscope.toml")
    law = rig_law(rig)
    whole = state(found(coulomb=0.6, presliding=5e-6), None, travelled(np.linspace(-0.018, 0.018, 240)))
    law.begin_learnt([np.full(4, value) for value in whole])
    law.reset(np.zeros(4), np.zeros(4))
    assert np.array(law.learnt_state())[:, 0].tolist() == whole


def findings(**values: float) -> Findings:
    return Findings(found=found(**values), travel=travelled(np.linspace(-0.018, 0.018, 240)))


def written(source: Path, file: Path, one: dict[str, Findings]) -> tuple[RigConfig, str]:
    text = rig_text(source, {name: each.found for name, each in one.items()}, "2026-01-01", "a")
    text, said = with_first_state(text, file, one, load_rig(source))
    file.write_text(text, encoding="utf-8")
    return load_rig(file), said


FOUND = {"x": findings(mass=0.91, coulomb=0.62, constant=0.05, presliding=7e-6)}


def test_a_rig_file_names_what_was_written_beside_it(tmp_path: Path) -> None:
    rig, said = written(RIGS / "microscope.toml", tmp_path / "new.toml", FOUND)
    assert rig.law.learnt == "new.learnt.json"
    assert said == f"{tmp_path / 'new.learnt.json'}: what its law begins with (x)"
    assert [len(values) for values in rig.law.learnt_state] == [KEPT, 0, 0, 0]
    assert sum(rig.law.learnt_state[0][:6]) == pytest.approx(0.62)
    middle = rig.law.learnt_state[0][7 + NODES // 2]
    assert middle == pytest.approx(2.1 - 0.05 + COULOMB - 0.62, abs=0.005), "beyond the weight that the model has"
    law = rig_law(rig)
    law.reset(np.zeros(4), np.zeros(4))
    begun = np.array(law.learnt_state())
    assert begun[:7, 0].tolist() == rig.law.learnt_state[0][:7]
    assert begun[4, 1] == rig.axes["y"].model.coulomb


def test_a_second_identification_keeps_what_other_axes_had(tmp_path: Path) -> None:
    first, _ = written(RIGS / "microscope.toml", tmp_path / "new.toml", FOUND)
    y = {"y": findings(mass=0.61, coulomb=0.5, constant=0.0, presliding=7e-6)}
    second, said = written(tmp_path / "new.toml", tmp_path / "later.toml", y)
    assert second.law.learnt == "later.learnt.json"
    assert second.law.learnt_state[0] == first.law.learnt_state[0]
    assert sum(second.law.learnt_state[1][:6]) == pytest.approx(0.5)
    assert said.endswith("(y)")
    document = tomlkit.parse((tmp_path / "later.toml").read_text())
    document["axes"]["x"]["model"]["viscous"] = 3.5  # type: ignore[index]
    text, _ = with_first_state(tomlkit.dumps(document), tmp_path / "last.toml", y, second)
    (tmp_path / "last.toml").write_text(text)
    assert load_rig(tmp_path / "last.toml").law.learnt_state[0] == [], "which was learnt with another model"


@pytest.mark.parametrize("law", ['name = "pd-feedforward"', 'name = "presliding-kalman"\niterative_learning = true'])
def test_a_law_that_keeps_nothing_or_a_whole_repeat_begins_without(law: str, tmp_path: Path) -> None:
    source = tmp_path / "rig.toml"
    source.write_text((RIGS / "paper.toml").read_text().replace('name = "pd-feedforward"', law, 1))
    rig, said = written(source, tmp_path / "new.toml", {"x": findings(mass=0.9, coulomb=0.6)})
    assert (rig.law.learnt, said) == ("", "")
    assert not (tmp_path / "new.learnt.json").exists()


def test_a_rig_that_is_refused_where_it_is_to_be_is_written_without_and_that_is_said(tmp_path: Path) -> None:
    document = tomlkit.parse((RIGS / "microscope.toml").read_text())
    document["task"] = {"kind": "path", "file": "beside-the-source.csv"}
    before = load_rig(RIGS / "microscope.toml")
    text, said = with_first_state(tomlkit.dumps(document), tmp_path / "new.toml", FOUND, before)
    assert "learnt" not in text
    assert said.startswith("nothing to begin with is written: ")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.long
def test_the_very_first_stroke_of_an_identified_stage_is_better_by_half(tmp_path: Path) -> None:
    """Experiments, files and a run of 5 mm, all in lockstep."""
    task = {"kind": "point_to_point", "axes": ["x"], "target": [5e-3], "move_s": 0.5, "dwell_s": 0.1}
    rig = rigs.one_axis(task=task, law={"name": "presliding-kalman"})
    document = rig.config.model_dump(mode="json", exclude_none=True)
    document["plant"] |= {"friction_variation": 0.1, "friction_period": 10e-3}
    source = tmp_path / "rig.toml"
    source.write_text(toml_text(document), encoding="utf-8")
    one = identify(load_rig(source), tmp_path, ["x"], lambda text: None, ["moves", "loops"])
    assert one["x"].refused.keys() <= {"cogging_amplitude", "cable_stiffness", "friction_variation"}
    begun, _ = written(source, tmp_path / "new.toml", one)
    most = []
    for config in (without_learnt(begun), begun):
        report, traces = simulate(config, tmp_path, 1.2)
        assert report.faults == {}
        most.append(float(np.nanmax(np.abs(traces.error))))
    assert most[1] < 0.5 * most[0]
