"""hil-client in an empty environment: small, without a controller, and it moves a rig over TLS."""

import os
import subprocess
import zipfile
from pathlib import Path

import pytest

from deploy.client.build import NEEDS, build
from deploy.debian.runtime_lock import closure
from tests.support.remote_rig import remote_rig
from tests.support.wheel_environment import install

MOVE = """
import sys
import hil
where, commands, operator = sys.argv[1:]
with hil.connect("paper", where, commands=commands, credentials=operator) as rig, rig.motion() as m:
    m.move_to(x=1e-3).wait(60)
    m.path({"x": [1e-3, 2e-3], "y": [0.0, 5e-4]}, blend=0.0).wait(60)
    print(rig.motion_status().setpoint[:2], rig.status().state)
"""


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build(tmp_path_factory.mktemp("wheel"))


@pytest.fixture(scope="module")
def python(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Of a new environment that holds the wheel, what it declares to need, and nothing else."""
    needs = set().union(*(closure(need, frozenset()) for need in NEEDS))
    return install(wheel, tmp_path_factory.mktemp("environment"), needs) / "python"


def said(python: Path, code: str, *arguments: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    clean = {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}
    line = [str(python), "-c", code, *arguments]
    return subprocess.run(line, cwd=cwd, env=clean, capture_output=True, text=True, timeout=120, check=False)


@pytest.mark.long
def test_it_holds_what_a_client_loads_and_no_controller(wheel: Path) -> None:
    names = zipfile.ZipFile(wheel).namelist()
    assert "hil/telemetry/remote_link.py" in names
    for file in ("cycle/step.py", "cycle/supervisor.py", "cycle/goal_desk.py", "live/loop.py", "cli/app.py"):
        assert f"hil/{file}" not in names
    assert [name for name in names if name.startswith(("drivers/bus/s", "sim_plant/physics", "hil/virtual"))] == []
    assert wheel.stat().st_size < 600_000


@pytest.mark.long
def test_what_it_lacks_is_said_with_what_to_install(python: Path, tmp_path: Path) -> None:
    done = said(python, "import hil; hil.simulate", cwd=tmp_path)
    local = "import hil, hil.connection; hil.connection._at_hand('paper')"
    assert "is not part of hil-client, which moves rigs on other" in said(python, local, cwd=tmp_path).stderr
    assert "hil.simulate is not part of hil-client, which watches and moves rigs: install hil" in done.stderr


@pytest.mark.live
@pytest.mark.long
def test_it_moves_an_emulated_rig_over_tls(python: Path, tmp_path: Path) -> None:
    with remote_rig(tmp_path) as remote:
        done = said(python, MOVE, remote.endpoint, remote.commands, str(remote.made / "operator"), cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() == "[0.002, 0.0005] ACTIVE"
