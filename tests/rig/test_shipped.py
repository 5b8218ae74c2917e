"""Rigs by name: a shipped one is found, and whatever is or looks like a path is taken as it is."""

from pathlib import Path

import pytest

from hil.rig.shipped import IncompleteError, by_name, names, shipped


def test_a_name_is_the_shipped_file() -> None:
    assert {"paper", "microscope"} <= set(names("rigs"))
    assert by_name("rigs", Path("microscope")) == shipped("rigs") / "microscope.toml"


@pytest.mark.parametrize("path", ["microscope.toml", "./a/microscope", "rigs/microscope", "unheard-of"])
def test_a_path_or_an_unknown_name_stays_what_it_is(path: str) -> None:
    assert by_name("rigs", Path(path)) == Path(path)


def test_a_file_here_goes_before_a_shipped_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "microscope").touch()
    monkeypatch.chdir(tmp_path)
    assert by_name("rigs", Path("microscope")) == Path("microscope")


def test_without_the_files_that_come_with_it_a_name_stays_what_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    def gone(kind: str) -> Path:
        raise IncompleteError(kind)

    monkeypatch.setattr("hil.rig.shipped.shipped", gone)
    assert by_name("rigs", Path("microscope")) == Path("microscope")
