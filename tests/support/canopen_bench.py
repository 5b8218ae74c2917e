"""Emulated CANopen drives and a master on a bus without delay, for tests."""

from collections.abc import Sequence

from drivers.config import BusConfig, Wiring
from drivers.families.cia402.host import Cia402Host
from drivers.families.cia402.node import Phase
from drivers.frame import Frame
from drivers.protocols.base import Command, Reject, Sample
from sim_plant.drives.canopen_drive import Cia402Drive
from sim_plant.drives.servo import ServoDrive

MS = 1_000_000
WATCHDOG_MS = 10
POSITION = 0.001  # m
RESOLUTION = 1e-7


def make_drive(node_id: int = 1, rated_force: float = 5.3) -> Cia402Drive:
    servo = ServoDrive(node_id - 1, rated_force, RESOLUTION, WATCHDOG_MS * MS, True, 0)
    return Cia402Drive(node_id, servo, lambda: POSITION * node_id)


class Bench:
    """The master and its drives; `tick` is one control period of 1 ms. deaf: nodes that neither hear nor speak."""

    def __init__(self, rated: Sequence[float] = (5.3, 20.0, 0.04, 1.0)) -> None:
        self.rated = list(rated)
        self.host = Cia402Host(Wiring(BusConfig(protocol="cia402"), len(self.rated), self.rated))
        self.drives = [make_drive(axis + 1, force) for axis, force in enumerate(self.rated)]
        self.deaf: set[int] = set()
        self.now = 0
        self.enable = 0
        self.reset = False
        self.force = [0.0] * len(self.rated)
        self.sent: list[Frame] = []
        self.heard: list[Frame] = []
        self.outcomes: list[Sample | Reject] = []

    def tick(self, count: int = 1) -> None:
        """Let the host work `count` ticks; frames take no time."""
        for _ in range(count):
            self.outcomes = [self.host.decode(frame) for frame in self.heard]
            self.now += MS
            self.sent = self.host.encode(Command(0, self.force, self.enable, self.reset))
            self.heard = [answer for frame in self.sent for answer in self.to_drives(frame)]

    def to_drives(self, frame: Frame) -> list[Frame]:
        """What the drives answer to a frame now."""
        stamped = frame._replace(timestamp_ns=self.now)
        answers = [a for d in self.drives if d.node_id not in self.deaf for a in d.on_frame(stamped)]
        return [answer._replace(timestamp_ns=self.now + 300_000) for answer in answers]

    def wait(self, milliseconds: int) -> list[Frame]:
        """Time passes in which the host says nothing; what the drives send by themselves."""
        self.now += milliseconds * MS
        return [frame for drive in self.drives for frame in drive.advance(self.now)]

    def bring_up(self) -> None:
        """Until every node runs and waits to be enabled."""
        for _ in range(1000):
            self.tick()
            if all(node.phase is Phase.RUNNING for node in self.host.nodes):
                self.tick(30)
                return
        raise AssertionError([node.phase for node in self.host.nodes])

    def samples(self) -> list[Sample]:
        """Of the last tick whose answers were decoded."""
        return [outcome for outcome in self.outcomes if isinstance(outcome, Sample)]
