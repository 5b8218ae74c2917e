"""Where the processes of one user meet, and why nobody else can come in."""

import os
from pathlib import Path

import pytest

from drivers import runtime_path
from drivers.runtime import RuntimeDirectoryError, runtime_dir


@pytest.fixture(autouse=True)
def bare_environment(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    for name in ("HIL_RUNTIME_DIR", "RUNTIME_DIRECTORY", "XDG_RUNTIME_DIR"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(runtime_path, "_SERVICE_DIRECTORY", str(tmp_path / "service"))


def mode(path: Path) -> int:
    return path.stat().st_mode & 0o777


def test_the_first_place_that_is_named_wins(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    session = tmp_path / "session"
    session.mkdir()
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(session))
    assert runtime_dir() == session / "hil"
    (tmp_path / "service").mkdir(mode=0o700)
    assert runtime_dir() == tmp_path / "service"
    monkeypatch.setenv("RUNTIME_DIRECTORY", f"{tmp_path}/unit:{tmp_path}/second")
    assert runtime_dir() == tmp_path / "unit"
    monkeypatch.setenv("HIL_RUNTIME_DIR", str(tmp_path / "chosen" / "deep"))
    assert runtime_dir() == tmp_path / "chosen" / "deep"
    assert mode(tmp_path / "chosen" / "deep") == 0o700


def test_without_any_named_place_it_is_in_memory_else_in_tmp_by_user(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(runtime_path, "_MEMORY", str(tmp_path))
    assert runtime_path.runtime_path() == f"{tmp_path}/hil-{os.geteuid()}"
    monkeypatch.setattr(runtime_path, "_MEMORY", str(tmp_path / "missing"))
    assert runtime_path.runtime_path() == f"/tmp/hil-{os.geteuid()}"


def test_a_directory_that_others_could_read_is_closed_to_them(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    place = tmp_path / "open"
    place.mkdir()
    place.chmod(0o755)
    monkeypatch.setenv("HIL_RUNTIME_DIR", str(place))
    assert mode(runtime_dir()) == 0o700


def test_a_directory_that_others_can_write_is_refused_and_left_alone(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    place = tmp_path / "shared"
    place.mkdir()
    place.chmod(0o1777)  # like /tmp itself
    monkeypatch.setenv("HIL_RUNTIME_DIR", str(place))
    with pytest.raises(RuntimeDirectoryError, match=r"shared: mode 1777 lets others write; must be 0700"):
        runtime_dir()
    assert mode(place) == 0o777


def test_a_planted_link_is_refused(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    (tmp_path / "target").mkdir(mode=0o700)
    (tmp_path / "link").symlink_to(tmp_path / "target")
    monkeypatch.setenv("HIL_RUNTIME_DIR", str(tmp_path / "link"))
    with pytest.raises(RuntimeDirectoryError, match="is not a directory"):
        runtime_dir()


def test_another_users_directory_is_refused_to_all_but_root(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    place = tmp_path / "theirs"
    place.mkdir(mode=0o700)
    monkeypatch.setenv("HIL_RUNTIME_DIR", str(place))
    owner = place.stat().st_uid
    monkeypatch.setattr(os, "geteuid", lambda: owner + 1)
    with pytest.raises(RuntimeDirectoryError, match=f"belongs to user {owner}, not to {owner + 1}"):
        runtime_dir()
    monkeypatch.setattr(os, "geteuid", lambda: 0)
    assert runtime_dir() == place


def test_a_place_that_cannot_be_made_is_named(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("HIL_RUNTIME_DIR", str(tmp_path / "file" / "below"))
    with pytest.raises(RuntimeDirectoryError, match=r"file/below: .*; set HIL_RUNTIME_DIR"):
        runtime_dir()
