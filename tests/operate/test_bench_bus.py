"""`hil bench bus`: what it measures is what a bus without delay, or one that loses frames, makes of it."""

import json
from pathlib import Path

import pytest
import typer
from typer.testing import CliRunner

from drivers.frame import Frame
from hil.operate.bench.bus import Exchange, Line, bus
from hil.operate.bringup.survey import Survey
from hil.rig.schema import RigConfig
from tests.support.bought_drives import RIGS_OF, write_files
from tests.support.bringup_bench import BringupBench
from tests.support.live_rig import CALM, PAPER, emulated

APP = typer.Typer()
APP.command()(bus)
TICKS = 300
SETS = [part for override in CALM for part in ("--set", override)]


def measured(kind: str, folder: Path, dropped: int = 0) -> list[Line]:
    """Every `dropped`-th frame of the first axis is lost."""
    write_files(folder)
    bench = BringupBench(RigConfig.model_validate(RIGS_OF[kind]()), folder)
    bench.run(Survey(bench.host))
    seen = 0

    def lose(frame: Frame) -> list[Frame]:
        nonlocal seen
        if frame.can_id not in positions:
            return [frame]
        seen += 1
        return [] if seen % dropped == 0 else [frame]

    positions = {0x180 + 3, 0x009}  # of node 3; of an ODrive of number 0
    if dropped:
        bench.change = lose
    exchange = Exchange(bench.host, TICKS, lambda: bench.now_ns)
    bench.run(exchange)
    return exchange.lines


def test_answers_are_timed_from_the_command_that_asked_for_them(tmp_path: Path) -> None:
    for line in measured("cia402", tmp_path):
        assert (line.expected, line.lost) == (TICKS - 1, 0)
        assert set(line.times_ns) == {200_000}  # the bench's own delay
        assert line.figures()["p99_us"] == 200.0


def test_a_lost_answer_is_counted_and_of_its_axis_alone(tmp_path: Path) -> None:
    first, second = measured("cia402", tmp_path, dropped=10)
    assert first.lost == pytest.approx(TICKS / 10, abs=1)
    assert second.lost == 0


def test_feedback_in_the_drives_own_time_is_measured_by_its_period(tmp_path: Path) -> None:
    for dropped in (0, 10):
        first, second = measured("odrive", tmp_path, dropped)
        assert second.lost == 0
        assert second.figures()["p50_us"] == pytest.approx(2500, rel=0.01)  # feedback_s of the rig
        assert first.lost == pytest.approx(TICKS / 10 if dropped else 0, abs=1)


@pytest.mark.live
def test_on_a_bus_with_an_emulated_stage(tmp_path: Path) -> None:
    with emulated():
        result = CliRunner().invoke(APP, [str(PAPER), *SETS, "--seconds", "0.3", "--json", str(tmp_path / "out")])
    assert result.exit_code == 0, result.output
    document = json.loads((tmp_path / "out").read_text())
    assert [line["name"] for line in document["lines"]] == ["x", "y"]
    for line in document["lines"]:
        assert 0 < line["p50_us"] <= line["p99_us"] <= line["max_us"]
        assert line["lost"] < line["expected"]


@pytest.mark.parametrize("words", [[], [str(PAPER), "--node", "3"], ["--node", "3", "--option", "x"]])
def test_what_cannot_be_measured_is_refused(words: list[str]) -> None:
    assert CliRunner().invoke(APP, words).exit_code == 2


def test_a_node_that_is_not_there_is_said_to_have_lost_all(tmp_path: Path) -> None:
    words = ["--node", "3", "-i", "local", "--seconds", "0.1", "--json", "-"]
    result = CliRunner().invoke(APP, words)
    assert result.exit_code == 1
    (line,) = json.loads(result.stdout)["lines"]
    assert line["lost"] == line["expected"] > 0
