"""The machine's folder of plug-ins: what is in it is found, as long as the folder is root's alone."""

import os
import stat
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from drivers.base import plugins
from drivers.base.plugins import Kind

KIND = Kind("law", "laws", "law", "name", "hil.laws", {}, ("reset", "force"))
CLASS = "class Mine:\n    def reset(self, q, f): ...\n    def force(self, x): ...\n"
ROOTS_ALONE = stat.S_IFDIR | 0o755


class Folder:
    """A folder as the file system tells of it, but for its owner and mode."""

    def __init__(self, path: Path, uid: int, mode: int) -> None:
        self._path, self._uid, self._mode = path, uid, mode

    def __str__(self) -> str:
        return str(self._path)

    def stat(self) -> os.stat_result:
        found = list(self._path.stat())
        found[stat.ST_UID], found[stat.ST_MODE] = self._uid, self._mode
        return os.stat_result(found)


@pytest.fixture
def opened(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[[int, int], None]]:
    """As a process that begins on a machine whose folder is of that owner and mode."""
    (tmp_path / "of_this_machine.py").write_text(CLASS)
    about = tmp_path / "of_this_machine-1.0.dist-info"
    about.mkdir()
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: of_this_machine\nVersion: 1.0\n")
    (about / "entry_points.txt").write_text("[hil.laws]\nmachines-own = of_this_machine:Mine\n")
    monkeypatch.setattr(sys, "path", list(sys.path))

    def begin(uid: int, mode: int) -> None:
        monkeypatch.setattr(plugins, "FOLDER", Folder(tmp_path, uid, mode))
        plugins._open_folder.cache_clear()

    yield begin
    sys.modules.pop("of_this_machine", None)
    plugins._open_folder.cache_clear()


def test_modules_and_registered_names_of_the_folder_are_found(opened: Callable[[int, int], None]) -> None:
    opened(0, ROOTS_ALONE)
    assert plugins.known(KIND, "machines-own")
    found = [plugins.find(KIND, name) for name in ("of_this_machine:Mine", "machines-own")]
    assert [made.__name__ for made in found] == ["Mine", "Mine"]
    assert plugins.package_digest(KIND, "machines-own").startswith(plugins.DIGEST)


def test_the_folder_comes_last_and_once(opened: Callable[[int, int], None], tmp_path: Path) -> None:
    opened(0, ROOTS_ALONE)
    before = list(sys.path)
    plugins.registered(KIND)
    plugins.registered(KIND)
    assert sys.path == [*before, str(tmp_path)]


@pytest.mark.parametrize(
    ("uid", "mode"),
    [(1000, 0o755), (0, 0o775), (0, 0o757), (0, 0o777), (1000, 0o700)],
    ids=["another's", "a group may write", "all may write", "all may do anything", "another's alone"],
)
def test_a_folder_that_others_may_write_to_is_as_if_it_were_not_there(
    opened: Callable[[int, int], None], uid: int, mode: int
) -> None:
    opened(uid, stat.S_IFDIR | mode)
    before = list(sys.path)
    assert not plugins.known(KIND, "machines-own")
    with pytest.raises(ValueError, match="No module named 'of_this_machine'"):
        plugins.find(KIND, "of_this_machine:Mine")
    assert sys.path == before


def test_a_file_in_the_folders_place_is_none(opened: Callable[[int, int], None]) -> None:
    opened(0, stat.S_IFREG | 0o644)
    assert plugins.registered(KIND) == []


def test_no_folder_is_no_error(opened: Callable[[int, int], None], tmp_path: Path) -> None:
    opened(0, ROOTS_ALONE)
    plugins.FOLDER._path = tmp_path / "none"  # type: ignore[attr-defined]
    assert plugins.registered(KIND) == []
