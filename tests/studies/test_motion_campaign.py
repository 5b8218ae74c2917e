"""The fault campaign while goals move the axes: a slice here, more of it in the slow lane; and proof that a stop which
leads out of the travel makes it fail.
"""

import os
from itertools import pairwise

import pytest

from hil.cycle.damped_stop import DampedStop
from hil.cycle.fault_monitor import FaultMonitor
from hil.cycle.goal import MotionWord
from hil.rig.file import load_rig
from hil.rig.schema import RigConfig, RigError
from hil.studies.fault_campaign.campaign import campaign
from hil.studies.fault_campaign.checkpoints import Checkpoint, bring_to
from hil.studies.fault_campaign.matrix import Cell, Chunk, displaced, plan_chunks, run_chunk
from hil.studies.fault_campaign.motions import motion_points
from hil.studies.fault_campaign.places import coast
from tests.support.paths import RIGS

WORDS = {MotionWord.HOLD, MotionWord.MOVE, MotionWord.JOG, MotionWord.STREAM, MotionWord.PATH, MotionWord.PAUSED}


def rig_of(name: str = "microscope-ideal", *changes: str) -> RigConfig:
    return displaced(load_rig(RIGS / f"{name}.toml", list(changes)))


def named(name: str) -> Checkpoint:
    return next(point for point in motion_points(rig_of()) if point.name == name)


def cells(only: str, *points: str) -> list[Cell]:
    chunks = plan_chunks(rig_of(), RIGS, only=only, motion=True)
    return [cell for chunk in chunks if chunk.point.name in points for cell in run_chunk(chunk)]


def failed(found: list[Cell]) -> list[str]:
    assert found
    return [f"{cell.checkpoint} / {cell.trial} / {cell.axis}: {cell.why}" for cell in found if not cell.passed]


def test_every_motion_word_is_looked_at_and_most_moments_are_on_the_way_into_the_fence() -> None:
    points = motion_points(rig_of())
    assert {point.word for point in points} >= WORDS
    assert len({point.name for point in points}) == len(points)
    assert any("HALT" in point.name for point in points)
    braking = [point.ticks for point in points if point.motion == "move" and "before" in point.name]
    assert {after - before for before, after in pairwise(braking)} == {5}


def test_a_moment_at_which_the_axes_do_something_else_is_no_moment_of_that_word() -> None:
    """A goal that is refused would leave the rig in HOLD, and every cell of it would say nothing."""
    point = named("MOVE, begun")
    with pytest.raises(RigError, match="at MOVE, begun the axes do MOVE"):
        bring_to(rig_of(), RIGS, Checkpoint(**vars(point) | {"word": MotionWord.JOG}))


SLICE = [chunk for chunk in plan_chunks(rig_of(), RIGS, stride=67, motion=True) if chunk.cells]


@pytest.mark.requirement(id="SR-9.6")
@pytest.mark.long
@pytest.mark.parametrize("chunk", SLICE, ids=[chunk.point.name for chunk in SLICE])
def test_every_fault_is_answered_as_demanded_while_goals_move_the_axes(chunk: Chunk) -> None:
    assert failed(run_chunk(chunk)) == []


@pytest.mark.long
@pytest.mark.requirement(id="SR-4.1")
@pytest.mark.parametrize("motion", ["MOVE", "JOG", "STREAM"])
def test_whoever_stops_the_axes_right_in_front_of_the_fence_leaves_them_inside_the_travel(motion: str) -> None:
    stops = cells("operator stops", *(f"{motion}, {k} ticks before the fence" for k in (5, 10, 15, 20)))
    assert failed(stops) == []
    assert {(cell.end, cell.fault) for cell in stops} == {("READY", "")}


@pytest.mark.long
@pytest.mark.replaces_methods
@pytest.mark.parametrize(("watched", "says"), [(True, "latched TRAVEL"), (False, "beyond its travel")])
def test_a_stop_that_only_holds_the_weight_makes_it_fail(
    watched: bool, says: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(DampedStop, "force", lambda stop, velocity: list(stop._gravity))
    if not watched:
        monkeypatch.setattr(FaultMonitor, "check_motion", lambda *arguments, **keywords: None)
    found = failed(cells("operator stops", "JOG, 15 ticks before the fence"))
    assert any(says in line for line in found), found


@pytest.mark.slow
@pytest.mark.parametrize("rig", ["microscope-ideal", "paper"])
def test_a_twelfth_of_all_faults_while_goals_move_the_axes_passes(rig: str) -> None:
    jobs = os.cpu_count() or 1
    assert failed(campaign([RIGS / f"{rig}.toml"], 12, jobs, lambda done, total: None, motion=True)) == []


def test_an_axis_coasts_by_its_energy_over_friction() -> None:
    axes = rig_of().axes
    assert coast(axes["x"], 0.06, braked=False) == pytest.approx(0.9 * 0.06**2 / 2 / 0.6)
    assert coast(axes["z"], 0.04, braked=False) == float("inf"), "its weight is more than its friction"
    assert coast(axes["z"], 0.04, braked=True) == pytest.approx(0.25 * 0.04**2 / 2 / 0.2)
