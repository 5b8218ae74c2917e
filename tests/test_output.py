"""What commands are to write: refused before a run where it cannot be written, and in one line where it then is not."""

import subprocess
import sys
from pathlib import Path

import pytest
from typer.testing import CliRunner

from hil.cli import build_app
from hil.exit_status import EXIT_FILE

PAPER = Path(__file__).parent.parent / "deploy" / "rigs" / "paper.toml"
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
    result = CliRunner().invoke(build_app(words[0]), [*words, "--json", str(tmp_path / name)], terminal_width=300)
    assert result.exit_code == 2
    assert reason in " ".join(result.output.split())
    assert list((tmp_path / "folder").iterdir()) == []


def test_a_folder_that_cannot_be_made_is_named_in_one_line(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    command = [sys.executable, "-m", "hil", "sweep", str(PAPER), "--plants", "1", "--output", str(tmp_path / "file/in")]
    result = subprocess.run(command, capture_output=True, text=True, check=False)
    assert result.returncode == EXIT_FILE
    assert result.stderr == f"hil: {tmp_path}/file/in: Not a directory\n"
