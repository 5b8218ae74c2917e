"""`hil diff` of two rig files: what an axis has become between two identifications."""

import json
from pathlib import Path

import pytest

from hil.cli.app import main
from hil.cli.exit_status import EXIT_CONFIG
from hil.identify.estimate import Estimate
from hil.identify.written import rig_text
from hil.rig.shipped import by_name


@pytest.fixture
def files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with two identifications of X: its mass is the same, its resonance has fallen by 3 Hz."""
    monkeypatch.chdir(tmp_path)
    source = by_name("rigs", Path("microscope"))
    for name, date, hertz in (("first", "2026-01-01", 196.0), ("second", "2026-03-01", 193.0)):
        found = {"mass": Estimate(0.9, 0.002, "kg"), "mode_frequency_hz": Estimate(hertz, 0.1, "Hz")}
        text = rig_text(source, {"x": found}, date, "a")
        (tmp_path / f"{name}.toml").write_text(text, encoding="utf-8")
    return tmp_path


def diff(monkeypatch: pytest.MonkeyPatch, *words: str) -> int:
    monkeypatch.setattr("sys.argv", ["hil", "diff", *words])
    with pytest.raises(SystemExit) as ended:
        main()
    return int(ended.value.code or 0)


@pytest.mark.usefixtures("files")
def test_what_left_both_intervals_is_named(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    assert diff(monkeypatch, "first.toml", "second.toml", "--json", "d.json") == 1
    told = capsys.readouterr().out
    assert "x: mode_frequency_hz changed from 2026-01-01 to 2026-03-01: wear, a screw, a cable?" in told
    document = json.loads(Path("d.json").read_text(encoding="utf-8"))
    assert {row["quantity"]: row["left"] for row in document["measured"]} == {"mass": False, "mode_frequency_hz": True}


@pytest.mark.usefixtures("files")
def test_two_measurements_that_agree_are_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    assert diff(monkeypatch, "first.toml", "first.toml") == 0


@pytest.mark.usefixtures("files")
def test_a_rig_that_nobody_measured_has_no_trend(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    Path("plain.toml").write_text(by_name("rigs", Path("microscope")).read_text(encoding="utf-8"), encoding="utf-8")
    assert diff(monkeypatch, "plain.toml", "first.toml") == EXIT_CONFIG
    assert "no axis has [axes.NAME.measured] in both files" in capsys.readouterr().err
