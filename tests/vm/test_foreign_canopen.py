"""The canopen package over the kernel's bus: as the master of our drive, and as the drives under our master."""

import contextlib
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from drivers.bus.any_bus import AnyPort, joined
from drivers.config import BusConfig
from hil.operate.bringup.session import open_session
from hil.operate.bringup.survey import Survey
from hil.rig.schema import RigConfig
from tests.operate.test_foreign_masters import (
    eds,
    test_a_402_master_goes_from_any_state_to_any_other,
    test_a_held_shaft_is_an_emergency_with_history_register_and_reset,
    test_heartbeats_are_told_and_the_masters_are_heard,
    test_numbers_go_expedited_and_what_does_not_fit_is_refused,
    test_pdos_are_mapped_anew_cyclic_event_driven_and_at_once,
)
from tests.support.bought_drives import EDS, cia402
from tests.support.foreign_drive import CST_DRIVE, ForeignDrive, eds_text
from tests.support.foreign_master import Bench, foreign_master
from tests.support.pushing import Push

__all__ = [  # of tests/operate/test_foreign_masters.py, where they run over the local bus
    "eds",
    "test_a_402_master_goes_from_any_state_to_any_other",
    "test_a_held_shaft_is_an_emergency_with_history_register_and_reset",
    "test_heartbeats_are_told_and_the_masters_are_heard",
    "test_numbers_go_expedited_and_what_does_not_fit_is_refused",
    "test_pdos_are_mapped_anew_cyclic_event_driven_and_at_once",
]
INTERFACE = "socketcan"
NODES = (3, 9)
SYNC_S = 0.05  # software emulation computes for over 5 ms what follows from one

pytestmark = pytest.mark.vcan


@pytest.fixture
def bench(eds: Path, vcan: str) -> Iterator[Bench]:
    with foreign_master(eds, interface=INTERFACE, channel=vcan, sync_s=SYNC_S) as made:
        yield made


@contextlib.contextmanager
def drives_on(channel: str) -> Iterator[list[ForeignDrive]]:
    """Two drives whose SDO servers are the package's."""
    drives = [ForeignDrive(CST_DRIVE, node, 5000) for node in NODES]
    ended = threading.Event()

    def serve(port: AnyPort) -> None:
        for drive in drives:
            for frame in drive.boot():
                port.send(frame)
        while not ended.is_set():
            first = port.wait(0.01)
            for frame in ([first] if first else []) + port.drain(time.monotonic_ns()):
                for drive in drives:
                    for answer in drive.on_frame(frame):
                        port.send(answer)

    with joined(BusConfig(interface=INTERFACE, channel=channel), fd=False) as port:
        thread = threading.Thread(target=serve, args=(port,))
        thread.start()
        try:
            yield drives
        finally:
            ended.set()
            thread.join()


def rig(channel: str) -> RigConfig:
    """Slow enough for software emulation."""
    facts = cia402()
    facts["bus"] |= {"interface": INTERFACE, "channel": channel}
    facts["bus"]["cia402"] |= {"rpdo": "own", "rated_torque": [5.0, 5.0]}
    facts["rate_hz"] = 20.0
    facts["drives"]["watchdog_s"] = 1.0
    return RigConfig.model_validate(facts)


def test_our_master_brings_its_drives_to_torque_and_back(vcan: str, tmp_path: Path) -> None:
    (tmp_path / EDS).write_text(eds_text(CST_DRIVE))
    with drives_on(vcan) as (first, second), open_session(rig(vcan), tmp_path) as session:
        survey = Survey(session.host)
        session.run(survey)
        report = survey.report()
        assert [(axis.name, axis.node, axis.phase, axis.problem) for axis in report.axes] == [
            ("x", 3, "RUNNING", ""),
            ("y", 9, "RUNNING", ""),
        ]
        assert {step.object: step.answer for step in report.axes[1].steps}["6060h:00"] == "done"
        push = Push(session.host, 0, 1.25, 20)
        session.run(push)
        assert push.enabled == 20
        assert (first.torque, second.torque) == (250, 0)  # 1.25 of 5 N, thousandths
        session.release()
        assert not session.host.any_enabled
        assert (first.torque, second.torque) == (0, 0)
