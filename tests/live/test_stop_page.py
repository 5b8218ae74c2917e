"""The stop page: a word in memory between whoever presses stop and the control process."""

import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from hil.live import stop_page
from hil.live.stop_line import RigInUseError, StopLine
from hil.live.stop_page import SIZE, live_pages, open_page


@pytest.fixture
def runtime(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("HIL_RUNTIME_DIR", str(tmp_path))
    tmp_path.chmod(0o700)
    return tmp_path


@pytest.fixture
def line(runtime: Path) -> Iterator[StopLine]:
    directory = runtime / "rig"
    directory.mkdir(mode=0o700)
    with StopLine(directory) as line:
        yield line


def test_a_press_is_seen_once_and_every_press_is_seen(line: StopLine) -> None:
    assert not line.pressed()
    (page,) = live_pages("rig")
    page.press()
    assert [line.pressed(), line.pressed()] == [True, False]
    page.press()
    assert line.pressed()


def test_what_the_loop_latched_is_read_back(line: StopLine) -> None:
    (page,) = live_pages("rig")
    line.tell("CONNECTED", 17)
    before = page.status()
    assert (before.state, before.index, before.pid, before.latched_at) == ("CONNECTED", 17, os.getpid(), 0)
    pressed_ns = page.press()
    assert page.await_latch(pressed_ns, 0.0).latched_at == 0
    line.latched("ESTOP", 18)
    after = page.await_latch(pressed_ns, 0.0)
    assert (after.latched_state, after.latched_index, after.state) == ("ESTOP", 18, "ESTOP")
    assert after.latched_at >= pressed_ns
    assert (after.presser_uid, after.presser_pid) == (os.getuid(), os.getpid())


def test_a_press_meant_for_an_earlier_process_does_not_stop_the_next(runtime: Path) -> None:
    (runtime / "rig").mkdir(mode=0o700)
    with StopLine(runtime / "rig"):
        live_pages("rig")[0].press()
    with StopLine(runtime / "rig") as line:
        assert not line.pressed()


def test_a_second_control_process_is_refused_and_the_first_keeps_its_page(line: StopLine, runtime: Path) -> None:
    with pytest.raises(RigInUseError, match=f"pid {os.getpid()}"):
        StopLine(runtime / "rig")
    live_pages("rig")[0].press()
    assert line.pressed()


def test_the_page_of_a_dead_process_is_nobodys(runtime: Path) -> None:
    (runtime / "rig").mkdir(mode=0o700)
    StopLine(runtime / "rig").close()
    assert (runtime / "rig" / "stop").exists()
    assert live_pages("rig") == []


def test_it_is_found_where_its_directory_was_removed_or_another_process_was_given_another_one(
    runtime: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    name = f"rig-{os.getpid()}"  # nobody else's on this machine, all of which is looked through at last
    (runtime / name).mkdir(mode=0o700)
    with StopLine(runtime / name) as line:
        (runtime / name / "stop").unlink()
        (runtime / name).rmdir()
        live_pages(name)[0].press()
        assert line.pressed()
        monkeypatch.setenv("HIL_RUNTIME_DIR", str(runtime / "elsewhere"))  # whoever names a directory means that one
        assert live_pages(name) == []
        monkeypatch.delenv("HIL_RUNTIME_DIR")
        monkeypatch.delenv("RUNTIME_DIRECTORY", raising=False)
        live_pages(name)[0].press()
        assert line.pressed()


def test_a_demos_page_is_found_by_the_rigs_name(runtime: Path) -> None:
    directory = runtime / "demo-123" / "rig"
    directory.mkdir(mode=0o700, parents=True)
    (runtime / "demo-123").chmod(0o700)
    with StopLine(directory) as line:
        live_pages("rig")[0].press()
        assert line.pressed()


@pytest.mark.parametrize("name", ["", ".", "..", "../rig", "other", "rig/", "a\nb", "\x1b[2J"])
def test_other_names_are_nobodys(line: StopLine, name: str) -> None:
    assert live_pages(name) == []


def test_what_is_no_page_is_not_written_to(runtime: Path) -> None:
    directory = runtime / "rig"
    directory.mkdir(mode=0o700)
    path = directory / "stop"
    for plant in (
        lambda: path.write_bytes(b"short"),
        lambda: path.write_bytes(b"x" * SIZE),
        lambda: path.mkdir(),
        lambda: os.mkfifo(path),
    ):
        plant()
        assert open_page(str(path)) is None
        path.rmdir() if path.is_dir() else path.unlink()


def test_a_symbolic_link_in_its_place_is_not_followed_by_the_control_process(runtime: Path) -> None:
    directory = runtime / "rig"
    directory.mkdir(mode=0o700)
    victim = runtime / "victim"
    victim.write_bytes(b"precious")
    (directory / "stop").symlink_to(victim)
    with pytest.raises(OSError, match="stop"):
        StopLine(directory)
    assert victim.read_bytes() == b"precious"


def test_a_page_that_is_cut_short_under_the_presser_is_no_sigbus(line: StopLine, runtime: Path) -> None:
    (page,) = live_pages("rig")
    os.truncate(runtime / "rig" / "stop", 0)
    page.press()  # pwrite(2), not a store into a mapping
    assert page.status().alive  # its process is, and mends it at its next sign of life
    os.truncate(runtime / "rig" / "stop", SIZE)


def test_a_directory_of_another_owner_is_not_trusted(line: StopLine, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(stop_page, "trusted_owner", lambda _path, _owner: False)
    assert list(stop_page._paths("rig")) == []


@pytest.mark.skipif(os.geteuid() != 0, reason="mounts a file system")
def test_a_full_file_system_is_an_error_that_names_the_path_and_leaves_a_stop_that_works(tmp_path: Path) -> None:
    code = """
import os, sys
from hil.live.stop_line import StopLine
from hil.live.stop_page import live_pages
root = os.environ["HIL_RUNTIME_DIR"]
os.mkdir(f"{root}/rig", 0o700)
line = StopLine(f"{root}/rig")
with open(f"{root}/filler", "wb", 0) as filler:
    try:
        while filler.write(bytes(4096)): pass
    except OSError: pass
live_pages("rig")[0].press()
line.latched("ESTOP", 3)
assert line.pressed() and live_pages("rig")[0].status().latched_state == "ESTOP"
try:
    StopLine(root)
except OSError as error:
    print(error)
"""
    mount = tmp_path / "full"
    mount.mkdir()
    script = f"mount -t tmpfs -o size=64k,mode=700 none {mount} && exec {sys.executable} -c '{code}'"
    done = subprocess.run(
        ["unshare", "-m", "sh", "-c", script],
        env={**os.environ, "HIL_RUNTIME_DIR": str(mount)}, capture_output=True, text=True, timeout=60,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert f"No space left on device: '{mount}/stop'" in done.stdout
