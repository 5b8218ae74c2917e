"""Six drives one can buy under our master: brought to their torque where they offer it, else refused by the object.

Each is made from facts of its maker's file twice: with the canopen package's LocalNode as its SDO server, and as
our own emulated drive.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Protocol

import pytest

from drivers.config import BusConfig, Wiring
from drivers.families.cia402.cia301 import DriveState
from drivers.families.cia402.config import Cia402Config
from drivers.families.cia402.host import Cia402Host
from drivers.families.cia402.node import Phase
from drivers.frame import Frame
from drivers.protocols import LayoutError
from drivers.protocols.base import Command
from sim_plant.drives.canopen_drive import Cia402Drive
from sim_plant.drives.servo import ServoDrive
from tests.support.foreign_drive import ForeignDrive, eds_text
from tests.support.real_drives import REAL_DRIVES, RealDrive

MS = 1_000_000
NODES = (3, 9)
FORCE = [0.25, -0.5]  # N m, of 0.5 rated


class AnyDrive(Protocol):
    """What both kinds have."""

    state: DriveState

    def on_frame(self, frame: Frame) -> list[Frame]:
        """What it answers."""


def host_of(real: RealDrive, folder: Path) -> Cia402Host:
    (folder / "real.eds").write_text(eds_text(real.facts, real.dummies))
    settings = Cia402Config.model_validate({"eds": ["real.eds"], "nodes": list(NODES), **real.states})
    return Cia402Host(Wiring(BusConfig(protocol="cia402", cia402=settings), 2, [0.5, 0.5], MS, folder))


def by_local_node(real: RealDrive, folder: Path) -> list[AnyDrive]:
    return [ForeignDrive(real.facts, node, values=real.values, dummies=real.dummies) for node in NODES]


def by_ourselves(real: RealDrive, folder: Path) -> list[AnyDrive]:
    made: list[AnyDrive] = []
    for axis, node in enumerate(NODES):
        servo = ServoDrive(axis, 0.5, 1e-6, 1000 * MS, False, 0)
        made.append(Cia402Drive(node, servo, lambda: 0.001, eds=folder / "real.eds"))
    return made


def torque(drive: AnyDrive) -> float:
    """N m that it applies."""
    return drive.servo.force if isinstance(drive, Cia402Drive) else drive.torque * 0.5e-3  # type: ignore[attr-defined]


@pytest.mark.parametrize("make", [by_local_node, by_ourselves])
@pytest.mark.parametrize("real", [real for real in REAL_DRIVES if not real.refused_by], ids=lambda real: real.name)
def test_a_drive_that_offers_cst_comes_to_its_torque(
    real: RealDrive, make: Callable[[RealDrive, Path], list[AnyDrive]], tmp_path: Path
) -> None:
    host = host_of(real, tmp_path)
    drives, heard, now = make(real, tmp_path), list[Frame](), 0
    for tick in range(800):
        for frame in heard:
            host.decode(frame)
        now += MS
        sent = host.encode(Command(0, FORCE, 3 if tick > 600 else 0, False))
        stamped = [frame._replace(timestamp_ns=now) for frame in sent]
        heard = [answer._replace(timestamp_ns=now) for frame in stamped for d in drives for answer in d.on_frame(frame)]
    assert [(node.phase, node.problem) for node in host.nodes] == [(Phase.RUNNING, "")] * 2
    assert [drive.state for drive in drives] == [DriveState.OPERATION_ENABLED] * 2
    assert [torque(drive) for drive in drives] == pytest.approx(FORCE, abs=5e-4)


@pytest.mark.parametrize("real", [real for real in REAL_DRIVES if real.refused_by], ids=lambda real: real.name)
def test_any_other_is_refused_by_the_objects_that_decide(real: RealDrive, tmp_path: Path) -> None:
    with pytest.raises(LayoutError) as refusal:
        host_of(real, tmp_path)
    for place in real.refused_by:
        assert f"axis 0 (Maker Made): {place} " in str(refusal.value)
    assert ("would not bound it" in str(refusal.value)) == ("6502h:00" in real.refused_by)
