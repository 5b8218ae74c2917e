"""Where the processes of one user meet, and why nobody else can come in."""

import os
from pathlib import Path

import pytest

from drivers.base import runtime_path
from drivers.base.runtime import (
    RuntimeDirectoryError,
    make_private,
    open_private,
    read_private,
    runtime_dir,
    write_private,
)


@pytest.fixture(autouse=True)
def bare_environment(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    for name in ("HIL_RUNTIME_DIR", "RUNTIME_DIRECTORY", "XDG_RUNTIME_DIR"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(runtime_path, "_SERVICE_DIRECTORY", str(tmp_path / "service"))


def belongs_to(monkeypatch: pytest.MonkeyPatch, owner: int) -> None:
    """Every directory that is looked at is that user's."""
    found = Path.lstat

    def lstat(path: Path) -> os.stat_result:
        status = found(path)
        return os.stat_result((*status[:4], owner, *status[5:]))

    monkeypatch.setattr(Path, "lstat", lstat)


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


@pytest.mark.parametrize("variable", ["HIL_RUNTIME_DIR", "RUNTIME_DIRECTORY"])
@pytest.mark.parametrize("user", [0, 4711])
def test_another_users_directory_is_refused_to_root_too(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, user: int, variable: str
) -> None:
    place = tmp_path / "theirs"
    place.mkdir(mode=0o700)
    monkeypatch.setenv(variable, str(place))
    belongs_to(monkeypatch, 1000)
    monkeypatch.setattr(os, "geteuid", lambda: user)
    with pytest.raises(RuntimeDirectoryError, match=f"belongs to user 1000, not to {user}"):
        runtime_dir()


def test_root_may_look_at_the_services_directory(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    (tmp_path / "service").mkdir(mode=0o700)
    belongs_to(monkeypatch, 1000)
    monkeypatch.setattr(os, "geteuid", lambda: 0)
    assert runtime_dir() == tmp_path / "service"
    monkeypatch.setattr(os, "geteuid", lambda: 4711)
    with pytest.raises(RuntimeDirectoryError, match="belongs to user 1000"):
        make_private(tmp_path / "service")


def test_a_file_of_a_runtime_directory_is_a_file_and_nobody_elses(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    (tmp_path / "file").write_bytes(b"word")
    assert read_private(tmp_path / "file") == b"word"
    (tmp_path / "link").symlink_to(tmp_path / "file")
    os.mkfifo(tmp_path / "pipe")
    for name in ("link", "pipe", ".", "missing"):
        with pytest.raises(OSError, match=name.replace(".", "is not a file")):
            open_private(tmp_path / name, os.O_RDONLY)
    status = os.stat(tmp_path / "file")
    theirs = os.stat_result((*status[:4], 4711, *status[5:]))
    monkeypatch.setattr(os, "fstat", lambda _fd: theirs)
    with pytest.raises(OSError, match="belongs to user 4711"):
        open_private(tmp_path / "file", os.O_RDONLY)


def test_writing_goes_through_no_planted_link(tmp_path: Path) -> None:
    precious = tmp_path / "precious"
    precious.write_text("as it was")
    (tmp_path / f"word.{os.getpid()}.new").symlink_to(precious)
    (tmp_path / "word").symlink_to(precious)
    write_private(tmp_path / "word", "new")
    assert (precious.read_text(), read_private(tmp_path / "word")) == ("as it was", b"new")
    assert mode(tmp_path / "word") == 0o600


def test_a_place_that_cannot_be_made_is_named(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("HIL_RUNTIME_DIR", str(tmp_path / "file" / "below"))
    with pytest.raises(RuntimeDirectoryError, match=r"file/below: .*; set HIL_RUNTIME_DIR"):
        runtime_dir()
