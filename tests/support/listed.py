"""What hil runs prints of a folder of runs."""

import json
import os
from pathlib import Path
from typing import Any

from typer.testing import CliRunner, Result

from hil.cli.app import build_app
from hil.runs.listed import listed_runs

EVIL = "a\x1b[31m\x07\u202eb"


def put(runs: Path, name: str, recording: Path, file: str = "run.mcap") -> Path:
    (runs / name).mkdir(exist_ok=True)
    os.link(recording, runs / name / file)
    return runs / name


def command(*words: str) -> Result:
    return CliRunner().invoke(build_app("runs"), ["runs", *words])


def documents(*words: str) -> dict[str, Any]:
    done = command("--json", "-", *words)
    assert done.exit_code == 0, done.output
    return {Path(row["run"]).name: row for row in json.loads(done.stdout)}


def known(folder: Path) -> list[dict[str, Any]]:
    return [run.facts for run in listed_runs(folder, lambda total: lambda: None)]
