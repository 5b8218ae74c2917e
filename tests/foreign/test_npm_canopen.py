"""The npm package `canopen`, a stack by others in another language, against our drives over the local bus.

The test installs the package into a folder of its own; where node or npm is missing, or the package cannot be had, it
is skipped with that reason. Frames go between node and the local bus by lines of JSON (npm_master.js).
"""

import contextlib
import json
import shutil
import subprocess
import threading
from collections.abc import Iterator
from pathlib import Path

import can
import pytest

from tests.operate.test_drive import Double
from tests.support.foreign_drive import I16, MOTION_DRIVE, Fact, eds_text

HERE = Path(__file__).parent
NODE = 3
PACKAGE = "canopen@6.2.1"
PATIENCE_S = 120.0

pytestmark = [pytest.mark.slow, pytest.mark.live]


@pytest.fixture(scope="module")
def package(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the package in it."""
    for program in ("node", "npm"):
        if shutil.which(program) is None:
            pytest.skip(f"{program} is not installed")
    folder = tmp_path_factory.mktemp("npm")
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


def test_it_walks_a_drive_through_all_that_a_master_asks(package: Path, tmp_path: Path) -> None:
    eds = tmp_path / "made.eds"
    eds.write_text(eds_text(MOTION_DRIVE | {(0x605A, 0): Fact(I16, "rw", "2")}))
    double = Double(eds)
    script = shutil.copy(HERE / "npm_master.js", package)
    node = subprocess.Popen(
        ["node", script, str(NODE)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, bufsize=1
    )
    said: list[dict[str, object]] = []
    with can.Bus(interface="local", channel="can0") as bus, forwarding(bus, node):
        assert node.stdout
        for line in node.stdout:
            told = json.loads(line)
            if "id" in told:
                data = bytes.fromhex(told["data"])
                bus.send(can.Message(arbitration_id=told["id"], data=data, is_extended_id=False), timeout=1.0)
            elif "order" in told:
                double.order(told["order"])
            else:
                said.append(told)
    assert double.end() == 0
    assert said == [{"passed": part} for part in ("transfers", "heartbeat", "pdo", "states", "emergency")]
    assert node.wait(PATIENCE_S) == 0


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
