"""The npm package `canopen`, a stack by others in another language, against our drives over the local bus."""

import json
import shutil
import subprocess
from pathlib import Path

import can
import pytest

from tests.foreign.npm_package import HERE, PATIENCE_S, Place, forwarding, package, place
from tests.operate.test_drive import Double
from tests.support.foreign_drive import I16, MOTION_DRIVE, Fact, eds_text

__all__ = ["package", "place"]  # fixtures
NODE = 3

pytestmark = [pytest.mark.slow, pytest.mark.live]


def test_it_walks_a_drive_through_all_that_a_master_asks(package: Path, place: Place, tmp_path: Path) -> None:
    eds = tmp_path / "made.eds"
    eds.write_text(eds_text(MOTION_DRIVE | {(0x605A, 0): Fact(I16, "rw", "2")}))
    double = Double(eds, "-i", place.interface, "--channel", place.channel)
    script = shutil.copy(HERE / "npm_master.js", package)
    node = subprocess.Popen(
        ["node", script, str(NODE)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, bufsize=1
    )
    said: list[dict[str, object]] = []
    with can.Bus(interface=place.interface, channel=place.channel) as bus, forwarding(bus, node):
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
