"""Bring-up procedures against a rig's emulated stage in exact virtual time, on a bus without delay."""

from collections.abc import Callable
from pathlib import Path

from drivers.frame import ECHO, Frame
from hil.operate.bringup.drive_host import DriveHost
from hil.operate.bringup.session import Procedure
from hil.operate.bringup.survey import Survey, SurveyReport
from hil.rig.schema import RigConfig
from sim_plant.emulator import EmulatedStage
from tests.support.bought_drives import RIGS_OF, write_files

_ANSWER_NS = 200_000
KINDS = ["cia402", "moteus", "odrive", "vesc"]


class BringupBench:
    """stage: the emulated drives. sent: frames of the latest tick. change: what becomes of a frame of the drives."""

    def __init__(self, rig: RigConfig, base_dir: Path) -> None:
        self.rig = rig
        self.host = DriveHost(rig, base_dir)
        rated = [axis.rated_force for axis in rig.axes.values()]
        self.stage = EmulatedStage(
            rig.plant, rig.bus, rig.axis_names, rated, base_dir, drives=rig.drives, mountings=rig.mountings
        )
        self.now_ns = 0
        self.slow = 1  # a tick takes so many periods
        self.sent: list[Frame] = []
        self.heard: list[Frame] = []
        self.foreign: list[Frame] = []  # of somebody else, in the next tick
        self.change: Callable[[Frame], list[Frame]] = lambda frame: [frame]

    def tick(self, procedure: Procedure) -> None:
        """One period: the procedure hears, speaks, and the drives answer."""
        heard, self.heard = self.heard, []
        for _ in range(self.slow):
            self.now_ns += self.rig.period_ns
            heard += [frame._replace(timestamp_ns=self.now_ns) for frame in self.stage.advance(self.now_ns)]
        heard = [changed for frame in heard for changed in self.change(frame)]
        foreign, self.foreign = self.foreign, []
        self.sent = procedure.step(self.now_ns, heard + foreign)
        for frame in self.sent:
            stamped = frame._replace(timestamp_ns=self.now_ns)
            if frame.can_id == self.host.protocol.echo_id:
                self.heard.append(stamped._replace(flags=frame.flags | ECHO))
            answers = self.stage.on_frame(stamped)
            self.heard += [answer._replace(timestamp_ns=self.now_ns + _ANSWER_NS) for answer in answers]

    def run(self, procedure: Procedure, most: int = 20_000) -> None:
        """Until it is done."""
        for _ in range(most):
            if procedure.done:
                return
            self.tick(procedure)
        raise AssertionError("the procedure does not end")

    def survey(self) -> SurveyReport:
        """A whole survey."""
        survey = Survey(self.host)
        self.run(survey)
        return survey.report()


def bench_of(kind: str, folder: Path, **plant: object) -> BringupBench:
    """A rig of bought drives of that kind. plant: keys of its [plant.drive]."""
    write_files(folder)
    rig = RIGS_OF[kind]()
    rig["plant"]["drive"] |= plant
    return BringupBench(RigConfig.model_validate(rig), folder)


class Keys:
    """A keyboard: `held` repeats at 30 Hz while it is set."""

    def __init__(self, bench: BringupBench) -> None:
        self._bench = bench
        self._next_ns = 0
        self.held = ""

    def __call__(self) -> str:
        """What was pressed since the last call."""
        if not self.held or self._bench.now_ns < self._next_ns:
            return ""
        self._next_ns = self._bench.now_ns + 33_000_000
        return self.held
