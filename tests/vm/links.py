"""CAN network interfaces of the running kernel, and the foreign tools that watch and disturb them."""

import json
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

PATIENCE_S = 120.0  # software emulation on a busy machine: generous, and only ever waited out by a failure
CAN_MTU, CANFD_MTU = 16, 72


def run(*command: str) -> str:
    """Output of a command that must succeed; its error text is in the failure otherwise."""
    done = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE_S)
    assert done.returncode == 0, f"{' '.join(command)}: {done.returncode}\n{done.stdout}{done.stderr}"
    return done.stdout


def ip(*arguments: str) -> str:
    """`ip ARGUMENTS`."""
    return run("ip", *arguments)


def eventually(holds: Callable[[], object], what: str) -> None:
    """Wait until `holds()` is true; fail naming `what` when patience ends."""
    deadline = time.monotonic() + PATIENCE_S
    while not holds():
        assert time.monotonic() < deadline, f"not within {PATIENCE_S:.0f} s: {what}"
        time.sleep(0.02)


def exists(name: str) -> bool:
    """Whether the kernel has an interface of that name, in this network namespace."""
    return Path("/sys/class/net", name).exists()


def add_vcan(name: str, mtu: int = CANFD_MTU) -> None:
    """A virtual CAN interface, up. mtu decides whether it carries FD frames."""
    ip("link", "add", name, "type", "vcan")
    ip("link", "set", name, "mtu", str(mtu), "up")


def remove(name: str) -> None:
    """Delete an interface if it is (still) there."""
    if exists(name):
        ip("link", "delete", name)


def details(name: str) -> dict[str, Any]:
    """What `ip -details -statistics` knows of an interface."""
    found: list[dict[str, Any]] = json.loads(ip("-json", "-details", "-statistics", "link", "show", name))
    return found[0]


def listeners(name: str) -> int:
    """How many receive filters of raw CAN sockets are bound to the interface, of whatever kind."""
    count = 0
    for table in Path("/proc/net/can").glob("rcvlist_*"):
        count += sum(line.split()[:1] == [name] for line in table.read_text().splitlines())
    return count


@contextmanager
def candump(name: str, *options: str) -> Iterator["subprocess.Popen[str]"]:
    """`candump -L OPTIONS NAME`, already listening when the block starts; terminated after it."""
    before = listeners(name)
    with subprocess.Popen(["candump", "-L", *options, name], stdout=subprocess.PIPE, text=True) as process:
        try:
            eventually(lambda: listeners(name) > before or process.poll() is not None, "candump listens")
            assert process.poll() is None, "candump ended at once"
            yield process
        finally:
            process.terminate()


def dumped(process: "subprocess.Popen[str]") -> list[str]:
    """Frames of a candump that ends by itself (option -n), as `ID#DATA`."""
    output, _ = process.communicate(timeout=PATIENCE_S)
    return [line.split()[2] for line in output.splitlines()]
