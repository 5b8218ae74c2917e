"""What commands are to write: refused before a run where it cannot be written, and in one line where it then is not."""

import io
import os
import re
import resource
import subprocess
import sys
from pathlib import Path

import pytest
from typer.testing import CliRunner

from hil.cli.app import build_app
from hil.cli.console import plain_console
from hil.cli.exit_status import EXIT_FILE, EXIT_UNAVAILABLE
from hil.cli.output import PICTURES
from hil.live.runtime_paths import known_sidecars
from hil.rig.file import load_rig
from hil.studies.tune.search import write_gains
from tests.support.command_line import CommandLine
from tests.support.paths import ROOT

PAPER = ROOT / "deploy" / "rigs" / "paper.toml"
FOR_EVER = "1e6"  # s of virtual time: a run that began would not end


@pytest.mark.parametrize(
    "words",
    [
        ["sim", str(PAPER), "--seconds", FOR_EVER],
        ["compare", str(PAPER), "--seconds", FOR_EVER],
        ["sweep", str(PAPER), "--seconds", FOR_EVER],
        ["check", str(PAPER)],
        ["faults", str(PAPER)],
        ["reproduce"],
        ["replay", "none.mcap"],
    ],
    ids=lambda words: words[0],
)
@pytest.mark.parametrize(("name", "reason"), [("none/x.json", "there is no folder"), ("folder", "cannot be written")])
def test_a_report_that_cannot_be_written_is_refused_before_anything_runs(
    tmp_path: Path, words: list[str], name: str, reason: str
) -> None:
    (tmp_path / "folder").mkdir()
    result = CliRunner().invoke(build_app(words[0]), [*words, "--json", str(tmp_path / name)])
    assert result.exit_code == 2
    assert reason in " ".join(result.output.replace("│", " ").split())  # wherever the frame breaks the line
    assert list((tmp_path / "folder").iterdir()) == []


@pytest.mark.parametrize(
    "words",
    [["sim", str(PAPER), "--seconds", FOR_EVER], ["compare", str(PAPER), "--seconds", FOR_EVER], ["check", str(PAPER)]],
    ids=lambda words: words[0],
)
@pytest.mark.parametrize("name", ["x.foo", "x"])
def test_a_picture_of_no_known_kind_is_refused_before_anything_runs(words: list[str], name: str) -> None:
    result = CliRunner().invoke(build_app(words[0]), [*words, "--picture", name])
    assert result.exit_code == 2
    assert f"Invalid value for '--picture': {name}: the name must end in one of .png," in result.output


def test_every_picture_that_is_not_refused_can_be_drawn(tmp_path: Path) -> None:
    from matplotlib.figure import Figure

    for suffix in PICTURES:
        Figure(figsize=(1, 1)).savefig(tmp_path / f"x{suffix}")
        Figure(figsize=(1, 1)).savefig(tmp_path / f"x{suffix.upper()}")


def test_a_folder_that_cannot_be_made_is_named_in_one_line(tmp_path: Path, hil_here: CommandLine) -> None:
    (tmp_path / "file").touch()
    result = hil_here("sweep", str(PAPER), "--plants", "1", "--out", str(tmp_path / "file/in"))
    assert result.returncode == EXIT_FILE
    assert result.stderr == f"hil: {tmp_path}/file/in: Not a directory\n"


def test_a_recording_that_finds_no_more_room_is_named_in_one_line(tmp_path: Path) -> None:
    """As on a full disk: 5000 bytes take its beginning, and no batch of ticks."""
    words = [sys.executable, "-m", "hil", "sim", str(PAPER), "--seconds", "0.5", "--record", str(tmp_path / "s.mcap")]
    limit = (5000, 5000)
    ended = subprocess.run(
        words, capture_output=True, text=True, check=False, cwd=tmp_path,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, limit),
    )  # fmt: skip
    assert ended.returncode == EXIT_FILE
    assert ended.stderr == f"hil: {tmp_path}/s.mcap: cannot be written: File too large\n"


@pytest.mark.parametrize("words", [["monitor", "--once"], ["command", str(PAPER), "stop"], ["blackbox", str(PAPER)]])
def test_a_runtime_directory_that_cannot_be_made_is_named_in_one_line(
    tmp_path: Path, words: list[str], hil_here: CommandLine, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "file").touch()
    monkeypatch.setenv("HIL_RUNTIME_DIR", str(tmp_path / "file/in/it"))
    result = hil_here(*words)
    assert result.returncode == EXIT_UNAVAILABLE
    assert result.stderr == f"hil: runtime directory {tmp_path}/file/in/it: Not a directory; set HIL_RUNTIME_DIR\n"


def test_nor_does_a_sidecar_begin_without_one(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    result = subprocess.run(
        [sys.executable, "-m", "hil", "sidecar", str(PAPER)],
        env={**os.environ, "HIL_RUNTIME_DIR": str(tmp_path / "file/in/it")},
        capture_output=True,
        text=True,
        check=False,
    )
    assert result.returncode == EXIT_UNAVAILABLE
    assert result.stderr == f"hil: runtime directory {tmp_path}/file/in/it: Not a directory; set HIL_RUNTIME_DIR\n"


def test_a_sidecar_that_ends_while_one_looks_for_it_is_none(private_runtime_dir: Path) -> None:
    (private_runtime_dir / "paper").mkdir()
    (private_runtime_dir / "paper" / "endpoint").symlink_to("gone")
    assert known_sidecars() == []


@pytest.mark.long
def test_a_terminal_without_the_letters_gets_question_marks_and_the_whole_report(tmp_path: Path) -> None:
    result = subprocess.run(
        [sys.executable, "-m", "hil", "check", str(PAPER)],
        env={**os.environ, "PYTHONIOENCODING": "ascii"},
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    assert (result.returncode, result.stderr) == (0, "")
    assert "phase margin" in result.stdout


def test_gains_found_on_a_full_disk_do_not_cost_the_rig_file(tmp_path: Path) -> None:
    rig = tmp_path / "rig.toml"
    rig.write_text(PAPER.read_text())
    rig.chmod(0o640)
    link = tmp_path / "link.toml"
    link.symlink_to(rig)
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1000, limits[1]))  # a disk that is full after 1000 bytes
    try:
        with pytest.raises(OSError, match="too large"):
            write_gains(link, "pid", {"kp": [1.0, 2.0]}, [])
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert rig.read_text() == PAPER.read_text()
    write_gains(link, "pid", {"kp": [1.0, 2.0]}, [])
    assert load_rig(rig).law.tuned["pid"] == {"kp": [1.0, 2.0]}
    assert link.is_symlink()
    assert rig.stat().st_mode & 0o777 == 0o640
    assert {path.name for path in tmp_path.glob("*.*")} == {"rig.toml", "link.toml"}


@pytest.mark.skipif(os.geteuid() != 0, reason="only root gives files away")
def test_gains_that_root_finds_leave_the_rig_file_to_its_owner(tmp_path: Path) -> None:
    rig = tmp_path / "rig.toml"
    rig.write_text(PAPER.read_text())
    rig.chmod(0o640)
    os.chown(rig, 1234, 5678)
    write_gains(rig, "pid", {"kp": [1.0, 2.0]}, [])
    found = rig.stat()
    assert (found.st_uid, found.st_gid, found.st_mode & 0o777) == (1234, 5678, 0o640)


def test_gains_found_by_who_may_write_the_rig_file_but_not_give_it_away_are_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rig = tmp_path / "rig.toml"
    rig.write_text(PAPER.read_text())

    def refused(*_: object) -> None:
        raise PermissionError

    monkeypatch.setattr(os, "chown", refused)
    write_gains(rig, "pid", {"kp": [1.0, 2.0]}, [])
    assert load_rig(rig).law.tuned["pid"] == {"kp": [1.0, 2.0]}


def test_no_console_makes_emoji_of_what_users_name() -> None:
    """`hil check --law ./mine.py:X` wrote "law ./mine.py❌ not accepted"."""
    text = io.StringIO()
    plain_console(file=text).print("law ./mine.py:x: not accepted")
    assert text.getvalue() == "law ./mine.py:x: not accepted\n"
    source = {path: path.read_text() for path in (ROOT / "hil").rglob("*.py")}
    assert sum(words.count("plain_console(") for words in source.values()) > 10
    made = [path for path, words in source.items() if re.search(r"(?<!\w)Console\(", words)]
    assert made == [ROOT / "hil" / "cli" / "console.py"]
