"""An emulated rig that holds, with a sidecar that is open to other machines, on the loopback."""

import contextlib
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from hil.cycle.state_machine import State
from hil.cycle.tick import CommandKind
from tests.support.certificates import certificates
from tests.support.live_rig import CALM, HEAVY, PAPER, Control, emulated, order
from tests.support.ports import free_port


class Remote(NamedTuple):
    """made: credentials of sidecar, operator, monitor. endpoint: to watch it. commands: to command and move it."""

    made: Path
    endpoint: str
    commands: str
    sidecar: subprocess.Popen[str]


@contextlib.contextmanager
def remote_rig(folder: Path) -> Iterator[Remote]:
    """The rig of the paper, READY. folder: for credentials and recordings."""
    made = certificates(folder / "made")
    endpoint, commands = f"tls/127.0.0.1:{free_port()}", f"127.0.0.1:{free_port()}"
    sets = [word for override in (*CALM, *HEAVY) for word in ("--set", override)]
    words = ["--listen", endpoint, "--credentials", str(made / "sidecar"), "--commands-from", commands]
    line = [sys.executable, "-m", "hil", "sidecar", str(PAPER), *sets, "--out", str(folder / "out"), *words]
    with emulated(HEAVY), Control(*[word for text in HEAVY for word in ("--set", text)]) as control:
        sidecar = subprocess.Popen(line, stdout=subprocess.PIPE, text=True)
        try:
            assert sidecar.stdout
            assert "listening" in sidecar.stdout.readline()
            reader = control.wait_for(State.READY)
            yield Remote(made, endpoint, commands, sidecar)
            assert control.process.poll() is None
            order(CommandKind.STOP)
            control.wait_for(State.READY, reader)
        finally:
            sidecar.kill()
            sidecar.communicate()
