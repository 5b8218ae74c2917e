"""A drift of 10 % over 20 runs is told; runs that only scatter are not; what runs take on the disk is told whole."""

import json
import math
import random
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner, Result

from hil.cli.app import build_app
from hil.rig.tables import TelemetryConfig
from hil.runs import listing
from hil.runs.facts import unread
from hil.runs.kept import KeptRun
from hil.runs.listed import ListedRun
from hil.runs.note import Note
from hil.runs.trend import evidence, slope, trends


def run(error: float, **changed: Any) -> ListedRun:
    axes = {"x": {"kind": "linear", "rms_error": error, "max_error": error}}
    known = {"outcome": "sound", "rig": "r", "rig_hash": "f" * 64, "law": "pid", "clock": "live", "axes": axes}
    return ListedRun(KeptRun(Path("runs/a"), "run", (), 0, 0, ""), {**unread(""), **known, **changed}, Note())


def drifting(over: int, change: float, scatter: float, draw: random.Random) -> list[float]:
    return [1e-7 * (1.0 + change * n / (over - 1)) * math.exp(draw.gauss(0.0, scatter)) for n in range(over)]


def drifts(errors: list[float]) -> bool:
    (found,) = trends(map(run, errors))
    return found.drifts


@pytest.mark.parametrize("change", [0.1, -0.1, 0.3, 1.0])
def test_a_drift_over_twenty_runs_is_told(change: float) -> None:
    draw = random.Random(43)
    assert all(drifts(drifting(20, change, 0.01, draw)) for _ in range(50))
    assert drifts(drifting(20, change, 0.0, draw))


@pytest.mark.parametrize("scatter", [0.0, 0.01, 0.03, 0.1, 0.5])
def test_runs_that_only_scatter_are_not_told(scatter: float) -> None:
    draw = random.Random(17)
    assert not any(drifts(drifting(20, 0.0, scatter, draw)) for _ in range(100))


def test_a_small_drift_is_not_told_however_clear_it_is() -> None:
    assert not drifts(drifting(20, 0.04, 0.0, random.Random(1)))


def test_single_bad_runs_neither_make_a_drift_nor_hide_one() -> None:
    draw = random.Random(5)
    steady, drift = drifting(20, 0.0, 0.01, draw), drifting(20, 0.2, 0.01, draw)
    for place in (18, 19):
        steady[place] *= 50.0
    for place in (3, 11):
        drift[place] *= 50.0
    assert not drifts(steady)
    assert drifts(drift)


def test_only_the_newest_runs_of_the_same_rig_and_clock_count() -> None:
    old = [run(1e-7) for _ in range(30)]
    new = [run(error) for error in drifting(20, 0.2, 0.0, random.Random(1))]
    other = [run(9e-7, rig_hash="0" * 64), run(9e-7, clock="virtual")]
    (found,) = trends([*old, *other, *new])
    assert found.drifts
    assert found.runs == 20
    assert found.change == pytest.approx(0.2, rel=0.05)
    assert (found.before, found.after) == pytest.approx((1e-7, 1.2e-7), rel=0.01)


def test_runs_that_stopped_or_lack_ticks_and_errors_that_are_none_do_not_count() -> None:
    worse = [run(5e-7, outcome="fault"), run(5e-7, missing="3 ticks"), run(math.nan), run(0.0)]
    (found,) = trends([*(run(1e-7) for _ in range(12)), *worse * 3])
    assert (found.runs, found.change, found.evidence, found.drifts) == (12, 0.0, 0.0, False)


def test_too_few_runs_are_no_drift() -> None:
    assert trends([run(1e-7), run(2e-7)]) == []
    (found,) = trends(run(1e-7 * 1.2**n) for n in range(9))
    assert found.evidence > 3.29
    assert not found.drifts


def test_slope_and_evidence_are_the_books() -> None:
    assert slope([0.0, 1.0, 2.0, 30.0]) == pytest.approx(5.5)  # of 1, 1, 28, 1, 14.5 and 10
    rising = [float(n) for n in range(20)]
    assert evidence(rising) == pytest.approx((190 - 1) / math.sqrt(950.0))
    assert evidence(rising[::-1]) == -evidence(rising)
    assert evidence([1.0, 1.0, 2.0]) == pytest.approx((2 - 1) / math.sqrt((3 * 2 * 11 - 2 * 1 * 9) / 18.0))
    assert evidence([1.0, 1.0]) == 0.0


def command(*words: str) -> Result:
    return CliRunner().invoke(build_app("runs"), ["runs", *words])


def test_the_command_names_the_axis_and_ends_with_1(monkeypatch: pytest.MonkeyPatch) -> None:
    errors = drifting(20, 0.1, 0.0, random.Random(1))
    monkeypatch.setattr(listing, "read", lambda folder: [run(error) for error in errors])
    done = command("trend")
    assert done.exit_code == 1
    assert done.output == "DRIFT: x RMS 100 nm to 110 nm, +10.0% over 20 runs of r, pid, live, rig hash ffffffff\n"
    assert command("trend", "--axis", "y").exit_code == 0
    (found,) = json.loads(command("trend", "--json", "-").stdout)
    assert (found["axis"], found["drifts"]) == ("x", True)
    monkeypatch.setattr(listing, "read", lambda folder: [run(1e-7)] * 20)
    done = command("trend")
    assert (done.exit_code, done.output.split(":")[0]) == (0, "no drift")


def test_the_disk_use_counts_every_file_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    sizes = {
        "run.mcap": 1, "a/run.mcap": 10, "a/run.part-2.mcap": 100, "a/fault-X-1-2.mcap": 1000,
        "a/blackbox-2.mcap": 10_000, "a/summary.json": 100_000,
    }  # fmt: skip
    for name, size in sizes.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_bytes(bytes(size))
    (tmp_path / "a" / "run.part-3.mcap").symlink_to(tmp_path / "a" / "summary.json")
    monkeypatch.setattr(listing, "read", lambda folder: [])
    found = json.loads(command("disk", "--in", str(tmp_path), "--json", "-").stdout)
    assert [row["bytes"] for row in found["kinds"].values()] == [111, 1000, 10_000, 100_000]
    assert (found["bytes"], found["kept"], found["quota"]) == (111_111, 11_111, TelemetryConfig().record_quota)
    assert command("disk", "--in", str(tmp_path)).exit_code == 0
    monkeypatch.setattr(listing, "read", lambda folder: [run(1e-7, quota=11_111), run(math.nan, **unread(""))])
    assert command("disk", "--in", str(tmp_path)).exit_code == 0
    monkeypatch.setattr(listing, "read", lambda folder: [run(1e-7, quota=11_110)])
    done = command("disk", "--in", str(tmp_path))
    assert done.exit_code == 1
    assert "the oldest go when the next recording begins" in done.output
