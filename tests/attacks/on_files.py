"""Attacks on files, processes and the machine: what is left of stop when everything around it is broken."""

import os
import shutil
import signal
import subprocess
import time
from collections.abc import Iterator

from hil.cycle.state_machine import State
from hil.live.stop_page import live_pages
from hil.operate.monitor import silence
from hil.telemetry.client import RigClient
from hil.telemetry.command_client import NoGatewayError
from tests.attacks.registry import attack
from tests.attacks.target import NAME, Target
from tests.support.paths import ROOT


def run(target: Target, *words: str, wrap: str = "", **environment: str) -> tuple[int, str]:
    """`hil WORDS`, by way of a shell where `wrap` has words that come before; exit status and all it said."""
    line = target.hil(*words)
    if wrap:
        line = ["unshare", "-m", "sh", "-c", f'{wrap}; exec "$@"', "sh", *line]
    done = subprocess.run(line, capture_output=True, text=True, timeout=60, cwd=ROOT, env={**os.environ, **environment})
    return done.returncode, (done.stdout + done.stderr).strip()


def refused(target: Target, code: int, text: str, wanted: str) -> str:
    assert code != 0, text
    assert wanted in text, text
    assert "Traceback" not in text, text
    return text.splitlines()[0][-140:]


@attack("a second control process of the live rig", "refused before it asks for a core; no tick of the first is lost")
def second_run(target: Target) -> Iterator[str]:
    code, text = run(target, "run", str(target.rig))
    assert target.newest() is State.READY
    yield refused(target, code, text, "another control process is running this rig")


@attack("a second emulator", "refused")
def second_emulator(target: Target) -> Iterator[str]:
    yield refused(target, *run(target, "emulate", str(target.rig)), "another emulator serves this rig")


@attack("a second sidecar", "refused")
def second_sidecar(target: Target) -> Iterator[str]:
    yield refused(target, *run(target, "sidecar", str(target.rig)), "another sidecar serves this rig")


SHM = "mount -t tmpfs -o mode=1777 none /dev/shm; "
FOREIGN = {"HIL_RUNTIME_DIR": "", "RUNTIME_DIRECTORY": "", "XDG_RUNTIME_DIR": ""}


@attack("foreign runtime directory, made by another user first", "refused, even by root")
def foreign_directory(target: Target) -> Iterator[str]:
    plant = SHM + "mkdir -m 700 /dev/shm/hil-0; chown 65534 /dev/shm/hil-0"
    yield refused(target, *run(target, "emulate", str(target.rig), wrap=plant, **FOREIGN), "belongs to user 65534")


@attack("foreign runtime directory with a false stop page", "hil estop does not believe it")
def foreign_page(target: Target) -> Iterator[str]:
    plant = SHM + "mkdir -p /dev/shm/hil-0/other; head -c 4096 /dev/zero > /dev/shm/hil-0/other/stop"
    plant += "; chown -R 65534 /dev/shm/hil-0"
    yield refused(target, *run(target, "estop", "other", wrap=plant, **FOREIGN), "no control process of the name")


@attack("planted symlink for the runtime directory", "refused")
def planted_link(target: Target) -> Iterator[str]:
    plant = SHM + "mkdir /dev/shm/x; ln -s /dev/shm/x /dev/shm/hil-0"
    yield refused(target, *run(target, "emulate", str(target.rig), wrap=plant, **FOREIGN), "is not a directory")


@attack("planted symlink for the stop page", "refused, and what it points to is left alone")
def planted_stop(target: Target) -> Iterator[str]:
    directory = target.base / "planted" / NAME
    directory.mkdir(parents=True, mode=0o700)
    os.chmod(directory.parent, 0o700)
    victim = target.base / "victim"
    victim.write_text("precious")
    (directory / "stop").symlink_to(victim)
    code, text = run(target, "run", str(target.rig), HIL_RUNTIME_DIR=str(directory.parent))
    assert victim.read_text() == "precious"
    yield refused(target, code, text, "planted/paper/stop")


@attack("a pipe in place of the stop page", "hil estop is not held up")
def pipe(target: Target) -> Iterator[str]:
    directory = target.base / "piped" / "other"
    directory.mkdir(parents=True, mode=0o700)
    os.chmod(directory.parent, 0o700)
    os.mkfifo(directory / "stop")
    began = time.monotonic()
    code, text = run(target, "estop", "other", HIL_RUNTIME_DIR=str(directory.parent))
    assert time.monotonic() - began < 5
    yield refused(target, code, text, "no control process of the name")


@attack("full runtime directory", "hil run ends with an error that names the file")
def full(target: Target) -> Iterator[str]:
    mount = target.base / "full"
    mount.mkdir()
    plant = f"mount -t tmpfs -o size=256k,mode=700 none {mount}"
    code, text = run(target, "run", str(target.rig), wrap=plant, HIL_RUNTIME_DIR=str(mount))
    yield refused(target, code, text, str(mount))


@attack("ESC in the name given to hil estop", "not passed on to the terminal")
def escape(target: Target) -> Iterator[str]:
    code, text = run(target, "estop", "\x1b[2J<script>")
    assert "\x1b" not in text
    yield refused(target, code, text, "no control process of the name")


@attack("rig file deleted", "hil estop works", moving=True)
def no_rig_file(target: Target) -> Iterator[str]:
    kept = target.rig.read_bytes()
    target.rig.unlink()
    yield stopped(target)
    target.rig.write_bytes(kept)


def stopped(target: Target) -> str:
    code, text = run(target, "estop", NAME)
    assert (code, target.newest()) == (0, State.ESTOP), text
    return text


@attack("no network at all", "hil estop works", moving=True)
def no_network(target: Target) -> Iterator[str]:
    line = ["unshare", "-n", *target.hil("estop", NAME)]
    done = subprocess.run(line, capture_output=True, text=True, timeout=30, cwd=ROOT)
    assert (done.returncode, target.newest()) == (0, State.ESTOP), done.stderr
    yield done.stdout.strip()


@attack("control process hangs", "the monitor says so within a second, hil estop at once")
def hung_control(target: Target) -> Iterator[str]:
    with RigClient(target.endpoint, rig=NAME) as client:
        client.wait_status(5.0)
        target.signal("run", signal.SIGSTOP)
        began = time.monotonic()
        try:
            while "HANGS" not in silence(client.wait_status(5.0), 0.0):
                assert time.monotonic() - began < 5.0
            took = time.monotonic() - began
            code, text = run(target, "estop", NAME)
        finally:
            target.signal("run", signal.SIGCONT)
        assert took < 1.0, f"{took:.1f} s"
        assert code == 70, text
        target.until(lambda: target.newest() is State.ESTOP, "the press waits for it")
        yield f"said so after {took:.2f} s; {text.splitlines()[0][-90:]}"


@attack("sidecar killed", "hil estop works; a new sidecar tells no old state", moving=True)
def no_sidecar(target: Target) -> Iterator[str]:
    target.signal("sidecar", signal.SIGKILL)
    target.processes["sidecar"].wait()
    seen = stopped(target)
    target.start("sidecar")
    target.until(lambda: _answers(target), "a new sidecar")
    with RigClient(target.endpoint, rig=NAME) as client:
        while not (status := client.wait_status(20.0)).state:
            pass
        assert status.state == "ESTOP", status.state
    yield f"{seen}; the new sidecar's first state is {status.state}"


def _answers(target: Target) -> bool:
    try:
        with target.operator():
            return True
    except NoGatewayError:
        return False


@attack("runtime directory deleted", "hil estop works all the same", moving=True, last=True)
def no_directory(target: Target) -> Iterator[str]:
    shutil.rmtree(target.directory)
    code, text = run(target, "estop", NAME)
    assert code == 0, text
    assert "ESTOP in tick" in text, text
    assert live_pages(NAME), "no page"
    yield text
