"""The command line before any command has begun."""

import os
import runpy
import subprocess
import sys
from pathlib import Path

import pytest

from tests.support.paths import ROOT

# A shell's background jobs start with SIGINT ignored, and their children with them.
AT_A_TERMINAL = "import signal; signal.signal(signal.SIGINT, signal.default_int_handler)"
BUILD = ROOT / "deploy" / "debian" / "build.sh"


@pytest.mark.parametrize(  # of the command line itself; of the command asked for; of the one that has no use for either
    ("module", "command"), [("typer", "check"), ("numpy", "check"), ("numpy", "run")]
)
def test_a_ctrl_c_during_the_imports_ends_quietly(tmp_path: Path, module: str, command: str) -> None:
    (tmp_path / f"{module}.py").write_text("import os, signal\nos.kill(os.getpid(), signal.SIGINT)\n")
    result = subprocess.run(
        [sys.executable, "-c", f"{AT_A_TERMINAL}; from hil.__main__ import main; main()", command, "rig.toml"],
        env={**os.environ, "PYTHONPATH": str(tmp_path)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert (result.returncode, result.stdout, result.stderr) == (130, "", "")


def test_the_packages_script_does_nothing_when_a_worker_process_reads_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    (line,) = (line for line in BUILD.read_text().splitlines() if line.endswith('> "$root/opt/hil/bin/hil"'))
    script = tmp_path / "hil"
    subprocess.run(["bash", "-c", line.replace("$root/opt/hil/bin", str(tmp_path))], check=True)
    monkeypatch.setattr(sys, "argv", ["hil", "--version"])
    runpy.run_path(str(script), run_name="__mp_main__")
    assert capsys.readouterr().out == ""
    with pytest.raises(SystemExit):
        runpy.run_path(str(script), run_name="__main__")
    assert capsys.readouterr().out.startswith("hil ")


@pytest.mark.parametrize("asked", ["--version", "--help"])
def test_who_asks_for_help_does_not_wait_for_the_rig_schema(asked: str) -> None:
    count = f"import sys; sys.argv = ['hil', '{asked}']\nfrom hil.__main__ import main\n"
    end = "try: main()\nexcept SystemExit: print(*{m.partition('.')[0] for m in sys.modules})"
    done = subprocess.run([sys.executable, "-c", count + end], capture_output=True, text=True, check=True)
    loaded = set(done.stdout.splitlines()[-1].split())
    assert "typer" in loaded
    assert not {"pydantic", "numpy", "scipy", "zenoh"} & loaded
