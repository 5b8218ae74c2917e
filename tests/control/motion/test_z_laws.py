"""The ways into a cell on a bench without a stage: where each stops, what it never does, and how it sees."""

from typing import Any

import pytest

from hil.control.motion.injection.cells import CellInjection
from hil.control.motion.injection.verdict import CellResult, Phase, Verdict
from hil.control.motion.injection.z_laws import Z_LAWS
from tests.support.bench_cell import AROUND, PARAMETERS, Bench, BenchCell

LIMIT = 1.4e-3


def injected(z_law: str, cell: BenchCell, **changes: Any) -> tuple[CellResult, Bench]:
    more = {"dimple": "dimple"} if z_law == "visual" else {}
    bench = Bench(CellInjection(AROUND, **{**PARAMETERS, "z_law": z_law, **more, **changes}), [cell])
    bench.run()
    return bench.motion.results[0], bench


def test_a_law_that_is_not_there_is_refused_with_those_that_are() -> None:
    there = "press, ramp, impedance, visual, position, hold"
    with pytest.raises(ValueError, match=rf"motion\.parameters\.z_law = 'presses'; allowed: {there}$"):
        CellInjection(AROUND, **{**PARAMETERS, "z_law": "presses"})


@pytest.mark.requirement(id="SR-8.3")
@pytest.mark.parametrize("z_law", [name for name in Z_LAWS if name != "hold"])
@pytest.mark.parametrize(
    ("cell", "verdict"),
    [
        (BenchCell(gone=True), Verdict.NO_CELL),
        (BenchCell(pierced_at=None), Verdict.NOT_PIERCED),
        (BenchCell(dead_after=10), Verdict.SENSOR_DEAD),
    ],
)
def test_a_cell_that_is_whole_gets_no_pulse_and_no_more_than_the_limit(
    z_law: str, cell: BenchCell, verdict: Verdict
) -> None:
    """A sensor that dies is seen by any of them. Impedance and position may be past the cell by then."""
    cell.pulses.clear()
    result, bench = injected(z_law, cell, press_speed=5e-4, seek_speed=5e-4)
    assert result.verdict is verdict, result.evidence
    assert cell.unpierced_pulses == 0
    assert bench.peak < 1.05 * LIMIT


@pytest.mark.parametrize("hold_force", [2e-4, 4e-4])
@pytest.mark.requirement(id="SR-8.3")
def test_hold_holds_its_force_and_pierces_nothing(hold_force: float) -> None:
    cell = BenchCell()
    result, bench = injected("hold", cell, hold_force=hold_force)
    assert result.verdict is Verdict.HELD, result.evidence
    assert cell.unpierced_pulses == 0
    assert bench.peak < 1.05 * hold_force
    assert result.held_rms < 8e-6
    assert result.ended_s - result.found_s > 1.0


@pytest.mark.parametrize(
    ("cell", "verdict"),
    [
        (BenchCell(gone=True), Verdict.NO_CELL),
        (BenchCell(pierced_at=100e-6), Verdict.BURST),
        (BenchCell(dead_after=10), Verdict.SENSOR_DEAD),
        (BenchCell(pierced_at=None, stiffness=3e3), Verdict.NOT_PIERCED),
    ],
)
def test_hold_says_why_it_could_not(cell: BenchCell, verdict: Verdict) -> None:
    result, _ = injected("hold", cell, press_speed=5e-4, seek_speed=5e-4)
    assert result.verdict is verdict, result.evidence


@pytest.mark.parametrize("z_law", ["press", "ramp"])
def test_those_that_feel_stop_at_the_puncture_and_go_on_to_the_depth_of_deposit(z_law: str) -> None:
    result, _ = injected(z_law, BenchCell())
    assert result.verdict is Verdict.OK, result.evidence
    assert -0.002 - result.rested < 205e-6  # pierced at 180 um
    assert result.deposit == pytest.approx(230e-6, abs=2e-6)


@pytest.mark.parametrize("z_law", ["impedance", "position"])
def test_those_that_are_planned_stop_at_the_planned_depth_alone(z_law: str) -> None:
    """230 um below the top that is expected, which is 20 um above the true one; nothing presses there any more."""
    result, _ = injected(z_law, BenchCell(top=-0.00202), stiffness=100.0)
    assert result.verdict is Verdict.OK, result.evidence
    assert result.rested == pytest.approx(-0.00223, abs=1e-6)


def test_position_does_not_pierce_what_lies_deeper_than_planned_and_press_does() -> None:
    cell = BenchCell(top=-0.00206)
    assert injected("position", cell)[0].verdict is Verdict.NOT_PIERCED
    assert injected("press", cell)[0].verdict is Verdict.OK


def test_impedance_gives_way_by_the_force_over_its_stiffness() -> None:
    """A cell that is never pierced: where the tip comes to rest, both springs share the planned way."""
    cell = BenchCell(pierced_at=None)
    _, bench = injected("impedance", cell, stiffness=5.0, press_speed=1e-3)
    depth = cell.top - bench.places[bench.phases.index(Phase.WITHDRAW) - 1]
    assert depth + cell.stiffness * depth**2 / 5.0 == pytest.approx(230e-6, abs=2e-6)


def test_ramp_is_slower_where_the_cell_is_stiffer() -> None:
    """The force runs ahead of its ramp there."""
    seconds = {}
    for force in (0.3e-3, 1.0e-3):
        result, _ = injected("ramp", BenchCell(stiffness=force / 180e-6**2), force_rate=1e-3)
        assert result.verdict is Verdict.OK, result.evidence
        seconds[force] = result.pierced_s - result.found_s
    assert seconds[1.0e-3] > 1.5 * seconds[0.3e-3]


def test_visual_sees_later_by_the_age_of_its_frames_and_comes_to_rest_deeper() -> None:
    """Frames of 30 Hz that are 50 ms old when they come: at 0.2 mm/s that is 10 to 17 um."""
    slow = {"press_speed": 2e-4, "seek_speed": 2e-4}
    felt, _ = injected("press", BenchCell(), **slow)
    seen, _ = injected("visual", BenchCell(), **slow)
    assert (felt.verdict, seen.verdict) == (Verdict.OK, Verdict.OK)
    assert 0.040 < seen.pierced_s - seen.found_s - (felt.pierced_s - felt.found_s) + (seen.found_s - felt.found_s) < 0.1
    assert 8e-6 < felt.rested - seen.rested < 20e-6
    assert seen.contact == pytest.approx(-0.002, abs=6e-6)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"z_law": "pres"}, "z_law = 'pres'; allowed: press, ramp, impedance, visual, position"),
        ({"z_law": "visual"}, "dimple = ''"),
        ({"dimple": "eye"}, "dimple = 'eye'"),
        ({"stiffness": 0.0}, "stiffness = 0.0; allowed: from 0.001 to 1e\\+06"),
        ({"admittance": True}, "admittance = True"),
        ({"force_rate": "fast"}, "force_rate = 'fast'"),
    ],
)
def test_parameters_that_cannot_be_are_refused_by_their_key(changes: dict[str, Any], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        CellInjection(AROUND, **{**PARAMETERS, **changes})
