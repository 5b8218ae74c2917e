"""The npm package `canopen` in a folder of its own, and the way between node and a bus.

Where node or npm is missing, or the package cannot be had, a test is skipped with that reason. Frames go by lines of
JSON. The VM lane's guest, which has no network, takes the package from where deploy/vm/test.sh has put it.
"""

import contextlib
import json
import shutil
import subprocess
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import can
import pytest

from tests.support.paths import ROOT

HERE = Path(__file__).parent
PACKAGE = "canopen@6.2.1"
PATIENCE_S = 120.0
PREPARED = ROOT / ".vm" / "npm"


class Place(NamedTuple):
    """Where the tests run. interface, channel: of python-can. rate_hz: of our master, as fast as the place bears."""

    interface: str = "local"
    channel: str = "can0"
    rate_hz: float = 100.0


@pytest.fixture
def place() -> Place:
    """The local bus."""
    return Place()


@pytest.fixture(scope="module")
def package(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the package in it."""
    for program in ("node", "npm"):
        if shutil.which(program) is None:
            pytest.skip(f"{program} is not installed")
    folder = tmp_path_factory.mktemp("npm")
    if (PREPARED / "node_modules").is_dir():
        shutil.copytree(PREPARED, folder, dirs_exist_ok=True)
        return folder
    words = ["npm", "install", PACKAGE, "--no-audit", "--no-fund", "--prefix", str(folder)]
    try:
        made = subprocess.run(words, capture_output=True, text=True, timeout=PATIENCE_S, check=False)
    except subprocess.TimeoutExpired:
        pytest.skip(f"npm cannot have {PACKAGE}: no answer from the registry in {PATIENCE_S:g} s")
    if made.returncode:
        pytest.skip(f"npm cannot have {PACKAGE}: {made.stderr.strip()[-300:]}")
    words = ["node", "-e", "require('canopen')"]
    loaded = subprocess.run(words, cwd=folder, capture_output=True, text=True, timeout=PATIENCE_S, check=False)
    if loaded.returncode:
        pytest.skip(f"{PACKAGE} does not load (it compiles a part of itself): {loaded.stderr.strip()[-300:]}")
    return folder


@contextlib.contextmanager
def forwarding(bus: can.BusABC, node: "subprocess.Popen[str]") -> Iterator[None]:
    """While open, what goes over the bus goes to the process, too."""
    ended = threading.Event()

    def forward() -> None:
        assert node.stdin
        with contextlib.suppress(OSError):  # it has ended
            while not ended.is_set():
                message = bus.recv(0.1)
                if message is not None:
                    line = json.dumps({"id": message.arbitration_id, "data": message.data.hex()})
                    node.stdin.write(f"{line}\n")

    thread = threading.Thread(target=forward)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()
