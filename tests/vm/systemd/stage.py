"""The stage on the other side of the emulated CAN bus: its controller, and its drives as a process behind it.

The controller lives in a network namespace of its own: the service reaches it over the bus and in no other way.
"""

import contextlib
import os
import subprocess
from collections.abc import Iterator
from pathlib import Path

from tests.vm.systemd.service import Rig, eventually

STAGE = Rig("stage")
CHANNEL = "canstage"  # the service's controller
NAMESPACE = "hilstage"
_CONTROLLER = Path("/run/stage-controller")  # the name the kernel gave the stage's controller


def remember_controller(name: str) -> None:
    """Note which controller has become the stage's."""
    _CONTROLLER.write_text(name)


def its_controller() -> str:
    """The stage's controller, by its name in the stage's network namespace."""
    return _CONTROLLER.read_text()


@contextlib.contextmanager
def powered() -> Iterator[None]:
    """The drives, as a process that runs as the service's user, for the length of the block."""
    command = (
        f"exec ip netns exec {NAMESPACE} setpriv --reuid=hil --regid=hil --clear-groups "
        f"hil emulate {STAGE.file} --set bus.channel={its_controller()}"
    )
    environment = {**os.environ, "RUNTIME_DIRECTORY": "/run/hil"}
    status = Path(f"/run/hil/{STAGE.name}/emulator.json")
    with subprocess.Popen(command, shell=True, env=environment) as process:
        try:
            eventually(lambda: status.exists() or process.poll() is not None, "the stage is there")
            assert process.poll() is None
            yield
        finally:
            process.terminate()
