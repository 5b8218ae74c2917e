"""The phases of a cell on a bench without a stage: what ends each, what verdict follows, and that no pulse is given
into a cell that is whole.
"""

from typing import Any

import pytest

from hil.control.motion.contract import Request
from hil.control.motion.injection.cells import CellInjection
from hil.control.motion.injection.detectors import Puncture, Slip
from hil.control.motion.injection.verdict import TOLD, Phase, Verdict
from tests.support.bench_cell import AROUND, PARAMETERS, Bench, BenchCell


def injected(*cells: BenchCell, seed: int = 1, **changes: Any) -> Bench:
    places = [[0.001 * (k + 1), 0.0, -0.002] for k in range(len(cells))]
    bench = Bench(CellInjection(AROUND, **{**PARAMETERS, "cells": places, **changes}), cells, seed)
    bench.run()
    return bench


def test_a_good_cell_goes_through_all_phases_in_their_order_and_is_ok() -> None:
    bench = injected(BenchCell())
    result = bench.motion.results[0]
    phases = [p for k, p in enumerate(bench.phases) if k == 0 or p != bench.phases[k - 1]]
    assert phases == [0, *range(Phase.APPROACH, Phase.LIFT + 1), TOLD + Verdict.OK]
    assert result.verdict is Verdict.OK
    assert abs(result.contact - -0.002) < 30e-6
    assert 0.6e-3 < result.pierced_force < 0.8e-3
    assert abs(result.deposit - 230e-6) < 2e-6
    assert result.bolus == pytest.approx(1.0)
    assert bench.cells[0].unpierced_pulses == 0
    assert len(bench.cells[0].pulses) == 50


@pytest.mark.requirement(id="SR-8.3")
@pytest.mark.parametrize(
    ("cell", "verdict", "pulses"),
    [
        (BenchCell(gone=True), Verdict.NO_CELL, 0),
        (BenchCell(pierced_at=None), Verdict.NOT_PIERCED, 0),
        (BenchCell(again_at=220e-6), Verdict.DOUBLE, 0),
        (BenchCell(shift=2e-5), Verdict.ROLLED, 0),
        (BenchCell(tip=3e-5), Verdict.BROKEN, 0),
        (BenchCell(dead_after=10), Verdict.SENSOR_DEAD, 0),
        (BenchCell(camera_until=250), Verdict.CAMERA_FROZEN, 0),
        (BenchCell(flow=3.0), Verdict.CLOGGED, 50),
        (BenchCell(closes_after=13), Verdict.UNKNOWN, 13),
        (BenchCell(closes_after=40), Verdict.OK, 40),
        (BenchCell(stays=4e-4), Verdict.STUCK, 50),
    ],
)
def test_each_anomaly_has_its_verdict_and_none_a_pulse_that_is_not_due(
    cell: BenchCell, verdict: Verdict, pulses: int
) -> None:
    bench = injected(cell)
    result = bench.motion.results[0]
    assert result.verdict is verdict, result.evidence
    assert (len(cell.pulses), cell.unpierced_pulses) == (pulses, 0)
    assert bench.peak < 1.05 * 1.4e-3
    assert bench.answer is not None
    assert bench.answer.position[2] == 0.0  # at the safe height


@pytest.mark.parametrize("ticks", [1, 13, 49])
def test_a_pulse_that_one_bad_tick_cut_is_given_to_its_end(ticks: int) -> None:
    bench = injected(BenchCell(cut_after=ticks))
    (result,) = bench.motion.results
    assert (result.verdict, len(bench.cells[0].pulses)) == (Verdict.OK, 50)
    assert result.bolus == pytest.approx(1.0)


@pytest.mark.parametrize("ticks", [0, 13])
def test_a_pulse_that_the_gate_cuts_for_good_is_told_with_its_length(ticks: int) -> None:
    """The bolus that is missing then was taken for a clogged pipette."""
    (result,) = injected(BenchCell(closes_after=ticks)).motion.results
    assert result.evidence == f"the valve was open for {ticks} ms of a pulse of 50 ms"
    assert result.bolus == pytest.approx(ticks / 50)


@pytest.mark.requirement(id="SR-8.3")
@pytest.mark.parametrize("missing", ["bolus", "valve"])
def test_evidence_that_is_missing_is_never_ok(missing: str) -> None:
    assert injected(BenchCell(), **{missing: ""}).motion.results[0].verdict is Verdict.UNKNOWN


def test_a_camera_that_freezes_once_the_cell_is_pierced_keeps_the_verdict_open() -> None:
    """The pulse was given; whether it came out nobody has seen."""
    cell = BenchCell(camera_until=400)
    result = injected(cell).motion.results[0]
    assert result.verdict is Verdict.CAMERA_FROZEN


def test_a_batch_goes_from_cell_to_cell_and_a_broken_tip_ends_it() -> None:
    bench = injected(BenchCell(), BenchCell(gone=True), BenchCell(tip=1e-3), BenchCell())
    assert [r.verdict for r in bench.motion.results] == [Verdict.OK, Verdict.NO_CELL, Verdict.BROKEN]
    told = [p - TOLD for p in bench.phases if p >= TOLD]
    assert told == [Verdict.OK, Verdict.NO_CELL, Verdict.BROKEN]


@pytest.mark.parametrize("seed", range(4))
def test_noise_alone_is_neither_contact_nor_puncture(seed: int) -> None:
    """Down to the deepest place through nothing at 0.5 mm/s: 700 ticks of noise, and no false touch."""
    bench = injected(BenchCell(gone=True), seed=seed, seek_speed=5e-4)
    assert bench.motion.results[0].verdict is Verdict.NO_CELL


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"cells": []}, "cells = \\[\\]"),
        ({"first": 2}, "first = 2; allowed: 1 to 1"),
        ({"cells": [[0.0, 0.0]]}, "row 1 is"),
        ({"cells": [[0.0, 0.0, -0.0059]]}, "takes z to"),
        ({"cells": [[0.02, 0.0, -0.002]]}, "takes x to"),
        ({"safe": -0.00199}, "start_above"),
        ({"safe": 0.02}, "safe = 0.02"),
        ({"force": "scale"}, "force = 'scale'"),
        ({"valve": "light"}, "valve = 'light'"),
        ({"along": "w"}, "along = 'w'"),
        ({"turn": "w"}, "turn = 'w'"),
        ({"turn": "z"}, "turn = 'z'"),
        ({"across": ["x", "z"]}, "across"),
        ({"seek_speed": -1.0}, "seek_speed = -1.0; allowed: from 1e-06 to 0.05"),
        ({"seek_sped": 1.0}, "seek_sped"),
        ({"force_limit": True}, "force_limit = True"),
    ],
)
def test_parameters_that_cannot_be_are_refused_by_their_key(changes: dict[str, Any], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        CellInjection(AROUND, **{**PARAMETERS, **changes})


# requests of an operator ----------------------------------------------------------------------------------------------


def asked(*requests: tuple[Request, int, Phase], cells: int = 3) -> tuple[Bench, list[int]]:
    """A batch in which each request comes once, in the second tick of a cell's phase; a pause lasts 400 ticks. Also
    the places of the tip in the second half of a pause, um.
    """
    places = [[0.001 * (k + 1), 0.0, -0.002] for k in range(cells)]
    bench = Bench(CellInjection(AROUND, **{**PARAMETERS, "cells": places}), [BenchCell() for _ in range(cells)])
    waiting, resume_at, low = list(requests), -1, []
    before = (0, 0)
    while bench.answer is None or not bench.answer.done:
        request = Request.NONE
        now = (bench.answer.cell, bench.answer.phase) if bench.answer else (0, 0)
        if waiting and now == before == (waiting[0][1], waiting[0][2]):
            request = waiting.pop(0)[0]
            resume_at = bench.tick + 400 if request is Request.PAUSE else resume_at
        elif bench.tick == resume_at:
            request = Request.RESUME
        before = now
        bench.step(request)
        assert bench.answer is not None
        if bench.answer.phase == Phase.PAUSED and resume_at - 200 < bench.tick < resume_at:
            low.append(round(bench.answer.position[2] * 1e6))
        assert bench.tick < 20_000
    assert waiting == []
    return bench, low


WHOLE = [Phase.NONE, Phase.APPROACH, Phase.TARE, Phase.SEEK]  # the tip has not pressed on the cell yet
TOUCHED = [Phase.PRESS, Phase.FREEZE, Phase.ADVANCE, Phase.PULSE]
OVER = [Phase.WITHDRAW, Phase.LIFT]


@pytest.mark.parametrize("phase", [*WHOLE, *TOUCHED, Phase.CONFIRM, *OVER])
def test_a_skip_ends_the_cell_in_hand_and_the_others_are_injected(phase: Phase) -> None:
    bench, _ = asked((Request.SKIP, 2, phase))
    verdict = Verdict.OK if phase in OVER else Verdict.UNKNOWN if phase is Phase.CONFIRM else Verdict.SKIPPED
    assert [r.verdict for r in bench.motion.results] == [Verdict.OK, verdict, Verdict.OK]
    assert [p - TOLD for p in bench.phases if p >= TOLD] == [Verdict.OK, verdict, Verdict.OK]
    pulses = [len(cell.pulses) for cell in bench.cells]
    assert pulses[0] == pulses[2] == 50
    assert pulses[1] == {Phase.CONFIRM: pulses[1], **dict.fromkeys(OVER, 50)}.get(phase, 0) <= 50
    assert sum(cell.unpierced_pulses for cell in bench.cells) == 0


@pytest.mark.parametrize("phase", [*WHOLE, *TOUCHED, Phase.CONFIRM, *OVER])
def test_a_pause_waits_at_the_safe_height_and_a_cell_that_is_whole_is_begun_anew(phase: Phase) -> None:
    bench, low = asked((Request.PAUSE, 2, phase))
    left = Verdict.UNKNOWN if phase is Phase.CONFIRM else Verdict.SKIPPED
    verdict = Verdict.OK if phase in (*WHOLE, *OVER) else left
    assert [r.verdict for r in bench.motion.results] == [Verdict.OK, verdict, Verdict.OK]
    assert bench.motion.results[1].number == 1
    assert low
    assert set(low) == {0}


@pytest.mark.parametrize("phase", [*WHOLE, *TOUCHED, Phase.CONFIRM, *OVER])
def test_an_abort_ends_the_batch_at_the_safe_height(phase: Phase) -> None:
    bench, _ = asked((Request.ABORT, 2, phase))
    verdicts = [r.verdict for r in bench.motion.results]
    assert verdicts[0] is Verdict.OK
    assert len(verdicts) == (1 if phase in WHOLE else 2)
    assert bench.answer is not None
    assert (bench.answer.position[2], bench.answer.velocity) == (0.0, [0.0, 0.0, 0.0])


def test_a_skip_while_paused_is_for_the_next_cell() -> None:
    bench, _ = asked((Request.PAUSE, 1, Phase.LIFT), (Request.SKIP, 2, Phase.PAUSED))
    assert [r.verdict for r in bench.motion.results] == [Verdict.OK, Verdict.SKIPPED, Verdict.OK]


def test_a_batch_that_begins_with_a_later_cell_counts_on() -> None:
    places = [[0.001 * (k + 1), 0.0, -0.002] for k in range(3)]
    bench = Bench(CellInjection(AROUND, **{**PARAMETERS, "cells": places, "first": 3}), [BenchCell()])
    bench.run()
    assert [(r.number, r.verdict) for r in bench.motion.results] == [(2, Verdict.OK)]
    assert bench.motion.total == bench.motion.over == 3


@pytest.mark.parametrize(
    ("phase", "verdict"),
    [
        (Phase.APPROACH, Verdict.OK),
        (Phase.SEEK, Verdict.OK),
        (Phase.PRESS, Verdict.UNKNOWN),
        (Phase.CONFIRM, Verdict.UNKNOWN),
        (Phase.LIFT, Verdict.UNKNOWN),
    ],
)
def test_a_cell_in_which_the_rig_stopped_is_not_touched_again(phase: Phase, verdict: Verdict) -> None:
    """The motion begins anew where the tip was left; a whole cell is injected as if nothing had been."""
    places = [[0.001 * (k + 1), 0.0, -0.002] for k in range(2)]
    bench = Bench(CellInjection(AROUND, **{**PARAMETERS, "cells": places}), [BenchCell(), BenchCell()])
    while not bench.phases or bench.phases[-1] != phase:
        bench.step()
    bench.restart()
    before = len(bench.cells[0].pulses)
    bench.run()
    assert [r.verdict for r in bench.motion.results] == [verdict, Verdict.OK]
    assert [p - TOLD for p in bench.phases if p >= TOLD] == [verdict, Verdict.OK]
    assert len(bench.cells[0].pulses) - before == (50 if verdict is Verdict.OK else 0)
    assert sum(cell.unpierced_pulses for cell in bench.cells) == 0


def test_a_pause_lasts_over_a_stop_of_the_rig() -> None:
    bench = Bench(CellInjection(AROUND, **PARAMETERS), [BenchCell()])
    for _ in range(20):
        bench.step()
    bench.step(Request.PAUSE)
    bench.restart()
    for _ in range(500):
        bench.step()
    assert bench.phases[-1] == Phase.PAUSED
    bench.step(Request.RESUME)
    bench.run()
    assert [r.verdict for r in bench.motion.results] == [Verdict.OK]


# Force behind a puncture at 4 mm/s, uN, tick by tick: the far membrane gives way, in the second one after some ms.
FAR_AT_ONCE = (416, 249, 123, 150, 262, 322, 220, 114, 27, 21)
NO_FAR = (374, 151, 110, 90, 84, 92, 79, 85, 88, 81)


def drops_again(forces: tuple[int, ...], puncture: Puncture, slip: Slip) -> int:
    """Sample at which a second drop is seen; -1: at none."""
    for place, force in enumerate(forces):
        if slip.take(force * 1e-6):
            puncture.restart()
        elif slip.over and puncture.take(force * 1e-6):
            return place
    return -1


def test_a_force_that_rises_behind_a_puncture_is_another_membranes() -> None:
    noise = 7.0 * 5e-6
    assert drops_again(FAR_AT_ONCE, Puncture(10, 0.3, noise), Slip(6, noise)) == 6
    assert drops_again(NO_FAR, Puncture(10, 0.3, noise), Slip(6, noise)) == -1
    assert drops_again(FAR_AT_ONCE, Puncture(10, 0.3, noise), Slip(9, 1.0)) == -1, "so it was"
