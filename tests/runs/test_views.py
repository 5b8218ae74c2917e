"""Runs one can look at: plot, diff, export and report, from a recording, its folder or an exported file."""

import csv
import json
import re
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import hil
from hil.cli.app import build_app
from hil.events.table import Kind
from hil.runs.report import MOST_EVENTS, Story, report_page
from hil.runs.views import differences
from hil.telemetry.event_log import own_event
from tests.support.paths import RIGS

PAPER = RIGS / "paper.toml"
QUICK = ["task.radius=0.01", "task.approach_s=0.2", "task.settle_s=0.1"]
EVIL = '<script>alert("1")</script>'


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """As a demo leaves it: run.mcap in a folder of its own."""
    folder = tmp_path_factory.mktemp("runs")
    hil.simulate(PAPER, 0.5, overrides=QUICK, record=folder / "run.mcap")
    return folder


@pytest.fixture(scope="module")
def run() -> hil.Simulation:
    return hil.simulate(PAPER, 0.5, overrides=QUICK)


def said(status: int, command: str, *arguments: str) -> str:
    done = CliRunner().invoke(build_app(command), [command, *arguments])
    assert done.exit_code == status, done.output
    return done.output


def test_a_run_is_read_from_a_recording_its_folder_or_an_export(run: hil.Simulation, folder: Path) -> None:
    kept = run.export(folder / "kept.npz")
    for path in (folder, folder / "run.mcap", kept):
        other = hil.load_run(path)
        assert differences(run, other)["same"]
        assert other.summary() == run.summary()
        assert other.events == run.events


def test_an_npz_file_loses_nothing(run: hil.Simulation, tmp_path: Path) -> None:
    first, second = (run.export(tmp_path / f"{name}.npz") for name in "ab")
    assert first.read_bytes() == second.read_bytes()
    read = hil.load_run(first)
    assert read.rig == run.rig
    assert {name: values.tobytes() for name, values in read.columns.items()} == {
        name: values.tobytes() for name, values in run.columns.items()
    }
    assert run.true is not None
    assert read.true is not None
    assert read.true.tobytes() == run.true.tobytes()


def test_an_npz_file_whose_rig_is_none_of_ours_is_refused_by_its_name(run: hil.Simulation, tmp_path: Path) -> None:
    with np.load(run.export(tmp_path / "whole.npz")) as whole:
        arrays = dict(whole)
    rig = arrays["rig_json"].tobytes().replace(b"following_error", b"followinq_error")
    np.savez(tmp_path / "other.npz", **(arrays | {"rig_json": np.frombuffer(rig, np.uint8)}))
    with pytest.raises(hil.RigError) as refused:
        hil.load_run(tmp_path / "other.npz")
    lines = str(refused.value).splitlines()
    assert all(line.startswith(f"{tmp_path / 'other.npz'}: axes.") for line in lines)
    assert any("followinq_error" in line for line in lines)


def test_a_csv_file_has_every_digit(run: hil.Simulation, tmp_path: Path) -> None:
    with run.export(tmp_path / "run.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [float(row["x_force"]) for row in rows] == run.force[:, 0].tolist()
    errors = np.array([float(row["y_error"] or "nan") for row in rows])
    assert np.array_equal(errors, run.error[:, 1], equal_nan=True)
    assert [row["state"] for row in rows] == run.state


@pytest.mark.parametrize("target", ["run.txt", "run"])
def test_a_file_of_another_kind_is_not_written(target: str, run: hil.Simulation, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"must end in \.csv, \.npz, \.parquet"):
        run.export(tmp_path / target)


def test_tables_of_other_libraries_are_the_same_table(run: hil.Simulation, tmp_path: Path) -> None:
    """Where they are not installed, that is what is said."""
    try:
        import pandas
        import pyarrow  # noqa: F401
    except ImportError:
        with pytest.raises(ImportError):
            run.export(tmp_path / "run.parquet")
    else:
        table = pandas.read_parquet(run.export(tmp_path / "run.parquet"))
        assert table["y_force"].tolist() == run.force[:, 1].tolist()
    try:
        import xarray  # noqa: F401
    except ImportError:
        with pytest.raises(ImportError):
            run.to_xarray()
    else:
        assert run.to_xarray()["force"].sel(axis="y").values.tolist() == run.force[:, 1].tolist()


@pytest.mark.parametrize("damage", ["cut", "nothing", "text", "no rig", "lengths"])
def test_a_damaged_export_is_refused_by_name(damage: str, run: hil.Simulation, tmp_path: Path) -> None:
    path = run.export(tmp_path / "run.npz")
    whole = path.read_bytes()
    if damage in ("cut", "nothing", "text"):
        path.write_bytes({"cut": whole[: len(whole) // 2], "nothing": b"", "text": b"time,x\n"}[damage])
    else:
        arrays = dict(np.load(path))
        if damage == "no rig":
            del arrays["rig_json"]
        else:
            arrays["force"] = arrays["force"][:-1]
        np.savez(path, **arrays)
    with pytest.raises(hil.RecordingError, match=r"run\.npz: not a run that hil has exported"):
        hil.load_run(path)
    assert "run.npz" in said(74, "plot", str(path))


class Page(HTMLParser):
    """What a browser would make of a page: its tags, and its text."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.words = ""
        self.sources: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.sources += [value or "" for name, value in attrs if name in ("src", "href")]

    def handle_data(self, data: str) -> None:
        self.words += data


@pytest.mark.long
def test_a_report_needs_nothing_else_and_tells_the_run(run: hil.Simulation, tmp_path: Path) -> None:
    first, second = (run.report(tmp_path / f"{name}.html").read_text() for name in "ab")
    assert first == second
    page = Page(first)
    assert page.tags.count("img") == len(run.axes)
    assert all(source.startswith("data:image/svg+xml;base64,") for source in page.sources)
    assert not {"script", "link", "iframe"} & set(page.tags)
    for text in ("READY -> ACTIVE", "pd-feedforward", run.trace_sha256, "radius", "max error", "500 ticks"):
        assert text in page.words
    assert "width=device-width" in first


def test_whatever_a_recording_says_is_shown_as_text(run: hil.Simulation) -> None:
    law = run.rig.law.model_copy(update={"source": EVIL, "name": EVIL})
    rig = run.rig.model_copy(update={"law": law, "description": EVIL})
    events = [(0.0, EVIL)] * (MOST_EVENTS + 3)
    text = report_page(rig, run, Story(run.summary(), events, {EVIL: EVIL}, EVIL))
    page = Page(text)
    assert "script" not in page.tags
    assert page.words.count(EVIL) > MOST_EVENTS + 5
    assert "and 3 more" in page.words


def test_a_law_that_failed_is_in_the_report(tmp_path: Path) -> None:
    source = "from hil import Law\n\n\nclass Own(Law):\n    def reset(self, position, force):\n        pass\n\n"
    (tmp_path / "own.py").write_text(source + "    def force(self, inputs):\n        return inputs.nothing\n")
    (tmp_path / "rig.toml").write_text(PAPER.read_text())
    run = hil.simulate(tmp_path / "rig.toml", 0.4, overrides=["law.name=./own.py:Own"])
    words = Page(run.report(tmp_path / "run.html").read_text()).words
    assert "own.py:9: AttributeError" in words
    assert "return inputs.nothing" in words


@pytest.mark.long
def test_the_commands_write_beside_the_run(folder: Path) -> None:
    for command, name in (("plot", "run.png"), ("report", "run.html"), ("export", "run.csv")):
        assert said(0, command, str(folder)).strip() == str(folder / name)
        assert (folder / name).stat().st_size > 1000
    assert said(0, "plot", str(folder), "-o", str(folder / "run.svg")).strip().endswith("run.svg")
    assert "must end in" in re.sub(r"\W+", " ", said(2, "export", str(folder), "-o", "run.txt"))
    assert "none.mcap" in said(74, "report", str(folder / "none.mcap"))


def test_a_diff_says_what_was_changed_and_what_came_of_it(folder: Path, tmp_path: Path) -> None:
    assert "the same, tick by tick" in said(0, "diff", str(folder), str(folder))
    other = tmp_path / "other.mcap"
    changed = [*QUICK, "law.name=structured-kalman", "plant.mass_scale=1.1"]
    hil.simulate(PAPER, 0.4, overrides=changed, record=other)
    written = tmp_path / "diff.json"
    text = said(1, "diff", str(folder), str(other), "--json", str(written))
    assert "law.name: 'pd-feedforward', 'structured-kalman'" in text
    document = json.loads(written.read_text())
    assert document["ticks"] == [500, 400]
    assert document["rig"][-1].startswith("plant.mass_scale: ")
    x = document["axes"]["x"]
    assert x["largest"]["force"] > 0.0
    assert x["peak_force"][0] != x["peak_force"][1]
    assert document["final_state"] == ["ACTIVE", "ACTIVE"]
    assert document["settled"] == [True, True]
    assert 300 < document["both"] < 400  # the axes are enabled first
    assert f"of the {document['both']} ticks in which both follow a task" in text


def test_a_diff_tells_where_accuracy_was_lost_and_that_a_run_was_too_short(folder: Path, tmp_path: Path) -> None:
    early = hil.simulate(PAPER, 0.2, overrides=QUICK)
    whole = hil.load_run(folder)
    early.log.append(own_event(Kind.ACCURACY_LOST, "noise", 1)._replace(axis="x"))
    found = differences(whole, early)
    assert found["settled"] == [True, False]
    assert "accuracy lost: noise on x" in found["events_new"]
    assert not early.summary()["settled"]
