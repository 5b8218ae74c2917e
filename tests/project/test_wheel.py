"""The wheels: installed without a checkout in sight, they run what the README shows, with the shipped rigs by name."""

import os
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

from deploy.compiled.build import missing
from deploy.debian.runtime_lock import closure
from tests.support.paths import ROOT
from tests.support.wheel_environment import install as install_with

ENVIRONMENTS = {"interpreted": {}, "compiled": {"HIL_COMPILED": "1"}}
COMMANDS = {  # what is asked -> what is said
    ("sim", "microscope", "--seconds", "1"): "RMS error",
    ("sim", "microscope", "--seconds", "1", "--faults", "bad-day"): "RMS error",
    ("check", "paper"): "stable",
    ("faults", "paper", "--stride", "97"): "cells passed",  # of all rigs it takes minutes
    ("reproduce", "--claims", "pdff-modelling-error"): "pdff-modelling-error",
    ("demo", "microscope", "--seconds", "2"): "summary.json",
}


def build(control_path: str, folder: Path) -> Path:
    command = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(folder)]
    subprocess.run(command, cwd=ROOT, env=os.environ | ENVIRONMENTS[control_path], check=True)
    (wheel,) = folder.glob("hil-*.whl")
    return wheel


def install(wheel: Path, environment: Path) -> Path:
    """bin/ of a new environment that holds the wheel, what it declares to need, and nothing else."""
    return install_with(wheel, environment, closure("hil", frozenset()) - {"hil"})


def said(program: Path, *arguments: str, cwd: Path) -> str:
    clean = {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}
    done = subprocess.run([program, *arguments], cwd=cwd, env=clean, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def assert_complete(wheel: Path, control_path: str) -> None:
    names = zipfile.ZipFile(wheel).namelist()
    assert len(set(names)) == len(names)
    assert {f"{package}/py.typed" for package in ("hil", "drivers", "sim_plant")} <= set(names)
    for kind in ("rigs", "scenarios", "systemd"):
        shipped = [path for path in (ROOT / "deploy" / kind).rglob("*") if path.is_file()]
        assert {f"hil/deploy/{path.relative_to(ROOT / 'deploy')}" for path in shipped} <= set(names)
    assert wheel.name.endswith("-py3-none-any.whl") == (control_path == "interpreted")


@pytest.mark.slow
@pytest.mark.parametrize("control_path", ENVIRONMENTS)
def test_a_wheel_in_an_empty_environment_runs_what_the_readme_shows(control_path: str, tmp_path: Path) -> None:
    if control_path == "compiled" and (lacking := missing()):
        pytest.skip(f"the compiled wheel needs {lacking}")
    wheel = build(control_path, tmp_path / "dist")
    assert_complete(wheel, control_path)
    programs = install(wheel, tmp_path / "environment")
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    assert said(programs / "hil", "--version", cwd=elsewhere).strip().endswith(f"control path {control_path}")
    loaded = said(programs / "python", "-c", "import hil.cycle.gate, sys; print(*sys.path)", cwd=elsewhere)
    assert str(ROOT) not in loaded
    for arguments, expected in COMMANDS.items():
        assert expected in said(programs / "hil", *arguments, cwd=elsewhere), arguments
