"""Sealed faults: the envelope holds, and of each kind one is told from the run's events alone, as all of them are."""

import random
from pathlib import Path

import numpy as np
import pytest

from hil.virtual.sim import simulate
from tests.sealed import seal
from tests.sealed.__main__ import faults
from tests.sealed.draw import KINDS, SOUND_RIGS, SOUND_S, Case, draw_fault, draw_sound
from tests.sealed.reader import Answer
from tests.sealed.run import answers
from tests.sealed.score import RIGHT, score
from tests.sealed.sound import sound
from tests.support.paths import RIGS


def test_the_same_seed_draws_the_same_faults_and_another_one_others() -> None:
    drawn = [[draw_fault(random.Random(seed)) for _ in range(2)] for seed in (1, 1, 2)]
    assert drawn[0] == drawn[1] != drawn[2]
    assert set(KINDS) == set(RIGHT)


def test_what_was_sealed_is_what_is_opened_and_nothing_else(tmp_path: Path) -> None:
    cases = [draw_fault(random.Random(seed)) for seed in range(5)]
    digest = seal.close(tmp_path, 3, cases)
    assert seal.opened(tmp_path) == cases
    assert seal.close(tmp_path, 3, cases) != digest, "a hash that can be guessed by trying all faults hides nothing"
    truth = tmp_path / "sealed.json"
    truth.write_text(truth.read_text().replace(cases[0].axis, "w"))
    with pytest.raises(ValueError, match="not the one that was sealed"):
        seal.opened(tmp_path)


def test_silence_a_wrong_axis_a_wrong_cause_and_an_early_alarm_are_no_right_answers() -> None:
    case = Case("microscope", 1, 9.0, "encoder_noise", "x", 5.0, 5.0, 1e-6)
    right = Answer("tick 5200 (5.200 s): accuracy lost: noise on x", "x", 5.2, 1)
    assert score(case, right)[:2] == (True, True)
    assert score(case, right).in_time
    assert not score(case, right._replace(at_s=5.6)).in_time
    assert not score(case, right._replace(at_s=4.9)).cause
    assert not score(case, right._replace(axis="y")).axis
    assert not score(case, right._replace(line="accuracy lost: friction up on x")).cause
    silent = score(case, Answer())
    assert not silent.cause
    assert not silent.in_time


@pytest.mark.long
def test_a_fault_that_shows_in_motion_is_drawn_where_the_axis_moves() -> None:
    """Where the stage stands a count beside home, two seconds of approach come before its cells."""
    case = draw_fault(random.Random(1), "axis_jam")
    assert (case.rig, case.axis) == ("microscope", "x")
    speeds = []
    simulate(
        case.config,
        RIGS,
        case.shows_s + 0.01,
        observer=lambda _t, _f, told: speeds.append(told.record["setpoint_velocity"][0]),
    )
    moving = np.abs(speeds) > 0.0
    assert moving[round(case.shows_s * 1e3)]
    assert not moving[round(case.at_s * 1e3) : round((case.shows_s - 0.05) * 1e3)].any()


@pytest.mark.long
@pytest.mark.parametrize("kind", sorted(KINDS))
def test_of_each_kind_one_is_told_with_cause_and_axis_and_a_quiet_one_soon(kind: str, tmp_path: Path) -> None:
    case = draw_fault(random.Random(1), kind)
    (said,) = answers([case], tmp_path)
    got = score(case, said)
    assert got.axis, said.line
    assert got.cause, said.line
    assert got.in_time, got.late_s


@pytest.mark.long
@pytest.mark.parametrize("rig", sorted(set(SOUND_RIGS)))
def test_of_a_sound_run_nothing_is_told(rig: str, tmp_path: Path) -> None:
    case = draw_sound(random.Random(rig))._replace(rig=rig, seconds=SOUND_S / 2)
    assert answers([case], tmp_path) == [Answer()]


def test_sound_runs_are_resumed_where_they_were_left_and_one_false_alarm_fails_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    ran, kept = [], tmp_path / "kept.jsonl"

    def answered(cases: list[Case], _folder: Path) -> list[Answer]:
        ran.extend(cases)
        return [Answer("fault latched: it was none") if len(ran) == 3 else Answer()]

    monkeypatch.setattr("tests.sealed.sound.answers", answered)
    assert sound(7, 2, tmp_path, kept)
    assert not sound(7, 4, tmp_path, kept)
    assert f"FALSE: {ran[2].rig}, plant.seed={ran[2].seed}: fault latched" in capsys.readouterr().out
    assert len(ran) == len(set(ran)) == 4
    assert not sound(7, 4, tmp_path, kept), "a false alarm stays one"
    assert sound(8, 5, tmp_path, kept, minutes=0.0)
    assert "0 false alarms in 0 of 5 sound runs" in capsys.readouterr().out
    assert len(ran) == 4


@pytest.mark.slow
def test_twenty_faults_meet_the_bars(tmp_path: Path) -> None:
    assert faults(20261127, 20, tmp_path)
