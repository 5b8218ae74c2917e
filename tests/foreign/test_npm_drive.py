"""The npm package `canopen` as the drives, under our CiA 402 master on the local bus.

Its stack is the device: SDO server, PDOs, NMT, heartbeats, emergencies, and the object dictionary of an EDS file.
What it lacks is made in npm_drive.js or left out:
- it knows CiA 301 alone: the power state machine of CiA 402 runs in the program, at every SYNC;
- it sends no boot-up message: the master finds the drives by their answers;
- `$NODEID` in an EDS means nothing to it: each drive has a file with its numbers in it;
- dummy objects in a mapping are not skipped but left out, so that what is behind them is read wrongly: no shared RPDO;
- the counter of SYNC is ignored, and a drive without 1200h answers no SDO;
- it answers reads of four bytes without telling their size, and applies a mapping when it becomes operational.
"""

import contextlib
import json
import shutil
import subprocess
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import can
import pytest

from drivers.protocols.base import DriveStatus
from hil.operate.bringup.session import open_session
from hil.operate.bringup.survey import Survey
from hil.rig.schema import RigConfig
from tests.foreign.npm_package import HERE, PATIENCE_S, Place, forwarding, package, place
from tests.support.bought_drives import EDS, cia402
from tests.support.foreign_drive import CST_DRIVE, U8, U32, Fact, eds_text
from tests.support.pushing import Push

__all__ = ["package", "place"]  # fixtures
NODES = (3, 9)
SERVED = CST_DRIVE | {
    (0x1014, 0): Fact(U32, "ro", "$NODEID+0x80"),
    (0x1200, 0): Fact(U8, "ro", "2"),
    (0x1200, 1): Fact(U32, "ro", "$NODEID+0x600"),
    (0x1200, 2): Fact(U32, "ro", "$NODEID+0x580"),
    (0x6076, 0): Fact(U32, "rw", "5000"),
}

pytestmark = [pytest.mark.slow, pytest.mark.live]


class Drives:
    """The node program, between its pipes and the local bus. said: what it told of its drives."""

    def __init__(self, folder: Path, eds: Path) -> None:
        for node in NODES:
            facts = {at: fact._replace(value=_number(fact.value, node)) for at, fact in SERVED.items()}
            eds.with_name(f"{eds.name}.{node}").write_text(eds_text(facts))
        script = shutil.copy(HERE / "npm_drive.js", folder)
        words = ["node", script, str(eds), *map(str, NODES)]
        self.process = subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, bufsize=1)
        self.said: list[dict[str, Any]] = []

    def serve(self, bus: can.BusABC) -> None:
        """Put what it sends on the bus, until it ends."""
        assert self.process.stdout
        for line in self.process.stdout:
            told = json.loads(line)
            if "id" in told:
                data = bytes.fromhex(told["data"])
                bus.send(can.Message(arbitration_id=told["id"], data=data, is_extended_id=False), timeout=1.0)
            else:
                self.said.append(told)

    def states(self, node: int) -> list[str]:
        """Those that the drive was in."""
        return [told["state"] for told in self.said if told["node"] == node and "state" in told]

    def fail(self, node: int) -> None:
        """A drive finds a fault: overcurrent."""
        assert self.process.stdin
        self.process.stdin.write(json.dumps({"order": "fault", "node": node}) + "\n")


def _number(value: str, node: int) -> str:
    """Without $NODEID, which the package does not know."""
    if not value.startswith("$NODEID+"):
        return value
    return hex(node + int(value.removeprefix("$NODEID+"), 16))


@contextlib.contextmanager
def drives_of(package: Path, place: Place, folder: Path) -> Iterator[Drives]:
    (folder / EDS).write_text(eds_text(SERVED))
    drives = Drives(package, folder / EDS)
    with can.Bus(interface=place.interface, channel=place.channel) as bus:
        thread = threading.Thread(target=drives.serve, args=(bus,))
        with forwarding(bus, drives.process):
            thread.start()
            try:
                yield drives
            finally:
                drives.process.terminate()
                thread.join(PATIENCE_S)
    drives.process.communicate()


def rig(place: Place) -> RigConfig:
    """Slow enough for pipes and a busy machine."""
    facts = cia402()
    facts["bus"] |= {"interface": place.interface, "channel": place.channel}
    facts["bus"]["cia402"] |= {"rpdo": "own", "rated_torque": [5.0, 5.0]}
    facts["rate_hz"] = place.rate_hz
    facts["drives"]["watchdog_s"] = 1.0
    return RigConfig.model_validate(facts)


def test_our_master_brings_them_to_torque_and_back(package: Path, place: Place, tmp_path: Path) -> None:
    with drives_of(package, place, tmp_path) as drives, open_session(rig(place), tmp_path) as session:
        survey = Survey(session.host)
        session.run(survey)
        report = survey.report()
        assert [(axis.name, axis.node, axis.phase, axis.problem) for axis in report.axes] == [
            ("x", 3, "RUNNING", ""),
            ("y", 9, "RUNNING", ""),
        ]
        assert {axis.state for axis in report.axes} <= {"READY_TO_SWITCH_ON", "SWITCHED_ON"}  # by how late they are
        assert sorted(node.identity.node_id for node in report.nodes) == list(NODES)
        made = {step.object: step.answer for step in report.axes[1].steps}
        assert (made["6502h:00"], made["6060h:00"]) == ("is 0x225", "done")
        push = Push(session.host, 0, 1.25, 20)
        session.run(push)
        assert push.enabled == 20
        session.release()
        assert not session.host.any_enabled
    climb = ["switch on disabled", "ready to switch on", "switched on", "operation enabled"]
    assert drives.states(3)[:4] == climb
    assert "operation enabled" not in drives.states(9)
    torques = [told["torque"] for told in drives.said if "torque" in told]
    assert 250 in torques  # 1.25 of 5 N, thousandths
    assert torques[-1] == 0


def test_a_fault_of_theirs_is_told_in_words(package: Path, place: Place, tmp_path: Path) -> None:
    with drives_of(package, place, tmp_path) as drives, open_session(rig(place), tmp_path) as session:
        session.run(Survey(session.host))
        push = Push(session.host, 0, 1.0, 1)
        session.run(push)
        drives.fail(3)
        push = Push(session.host, 0, 1.0, 1_000_000)
        session.run(push)
        assert session.host.status(0) & DriveStatus.FAULT
        assert "node 3: " in session.host.problem(0)
        assert "2310h" in session.host.problem(0)
        assert session.host.problem(1) == ""
    assert drives.states(3)[-1] == "fault"
