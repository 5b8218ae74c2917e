"""A cause for every row of the fault table, in lockstep on the paper's stage."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from drivers.protocols.base import DriveStatus
from drivers.wire.faults import FaultKind
from hil.cycle.fault_table import Fault
from hil.cycle.state_machine import State
from hil.cycle.step import ControlCycle
from hil.cycle.tick import CommandKind
from hil.rig.file import load_rig
from hil.rig.schema import RigConfig
from hil.studies.fault_campaign.injections import (
    Encoder,
    answer_twice,
    axis_frames,
    babble,
    bend,
    disbelieve,
    drop_out,
    encoder_creep,
    fail,
    foreign_command,
    forge,
    law_asks,
    overruns,
    queue_full,
    says_enabled,
    set_to,
    stamp_off,
    status_bit,
    swing,
    trip,
    withdrawn,
)
from hil.studies.fault_campaign.layout_capabilities import BABBLE
from hil.studies.fault_campaign.sensors import beyond, falsified, skipping
from hil.studies.fault_campaign.trial import Step, host_frames, once
from hil.virtual.lockstep import LockstepRun, Observer
from sim_plant.nodes.sensor import silent, stuck
from tests.cycle.expected_faults import BITS
from tests.support.paths import RIGS

BEGIN = 700  # tick from which the cause is there: the approach to the figure, both axes move
AXIS = 1
Y = "y"


@dataclass(frozen=True)
class Cause:
    """step: as of a trial (hil/studies/fault_campaign/trial.py), from tick `begin` on. axis: whose the fault is, a
    sensor's name too, or empty. rig: overrides. beside: what the drives' host takes the rig for, where that is not what
    it is.
    """

    fault: Fault
    step: Step
    axis: str = ""
    rig: tuple[str, ...] = ()
    begin: int = BEGIN
    ticks: int = 300
    activates: bool = True
    beats: int = 0  # heartbeats from the operator, until that tick
    beside: tuple[str, ...] = ()
    inside: bool = False

    def run(self, observer: Observer) -> LockstepRun:
        """The whole run."""
        rig = load_rig(RIGS / "paper.toml", self.rig)
        run = _Run(rig, self, observer)
        if self.beside:
            run.cycle = ControlCycle(load_rig(RIGS / "paper.toml", (*self.rig, *self.beside)), RIGS)
        for tick in range(self.begin + self.ticks):
            if run.index >= self.begin:
                self.step(run, AXIS, tick - self.begin)  # type: ignore[arg-type]
            run.tick()
        return run

    @property
    def believed(self) -> RigConfig:
        """What the control process takes the rig for."""
        return load_rig(RIGS / "paper.toml", (*self.rig, *self.beside))


class _Run(LockstepRun):
    def __init__(self, rig: RigConfig, cause: Cause, observer: Observer) -> None:
        def operator(run: LockstepRun, index: int) -> Sequence[CommandKind]:
            said = [CommandKind.HEARTBEAT] if index < cause.beats else []
            ready = run.cycle.state is State.READY and run.activated_at < 0 and cause.activates
            begins = CommandKind.ACTIVATE if run.cycle.homing is None else CommandKind.HOME
            return [*said, begins] if ready else said

        super().__init__(rig, RIGS, operator=operator, observer=observer)


def _nothing(run: LockstepRun, axis: int, k: int) -> None:
    pass


def _never_enabled(run: LockstepRun, axis: int) -> None:
    run.stage.drives[axis].taps.append(lambda s: replace(s, status=s.status & ~int(DriveStatus.ENABLED)))


def _drifts(counts: int) -> Step:
    return Encoder(lambda count, held, k: count + counts * k)


_LOOSE = tuple(f"axes.{axis}.limits.following_error=1.0" for axis in "xy")
_PUSHES = tuple(f"axes.{axis}.push={{force={force}, distance=4e-3}}" for axis, force in (("x", 1.6), ("y", 0.4)))
_UNHOMED = ('axes.y.home={by="drive"}', 'plant.switches=[{axis="y", zero=0.1}]')
_SENSOR = ('sensors.force={can_id=0x300, unit="N", scale=1e-8, noise=5e-6, range=[-0.01, 0.01]}',)
_wire: Callable[..., Step] = host_frames

_CAUSES = (
    Cause(Fault.ENCODER_GAP, axis_frames(FaultKind.DROP, count=1), Y),
    Cause(Fault.ENCODER_LOST, axis_frames(FaultKind.DROP), Y),
    Cause(Fault.ENCODER_DEAD, axis_frames(FaultKind.DROP), Y),
    Cause(Fault.BAD_FRAMES, forge(lambda frame: frame._replace(data=frame.data[:5]))),
    Cause(Fault.ENCODER_GLITCH, Encoder(lambda count, held, k: count + (10**7 if k == 0 else 0)), Y),
    Cause(Fault.ENCODER_JUMP, Encoder(lambda count, held, k: count + 10**7), Y),
    Cause(Fault.ENCODER_STUCK, Encoder(lambda count, held, k: held), Y, _LOOSE),
    Cause(Fault.FOLLOWING_ERROR, bend(0.2, 0.0), Y, inside=True),
    Cause(Fault.TRAVEL_PLANNED, bend(2.0, 0.0), Y, inside=True),
    Cause(Fault.TRAVEL, _drifts(5_000_000), Y, (*_LOOSE, "axes.y.limits.speed=1000.0")),
    Cause(Fault.SPEED_PLANNED, bend(0.0, 3.0), Y, inside=True),
    Cause(Fault.SPEED, law_asks(set_to(1e9)), Y, _LOOSE, inside=True),
    Cause(Fault.NOT_FINITE, law_asks(set_to(np.inf)), Y, inside=True),
    Cause(Fault.FILTER_DIVERGED, disbelieve, Y, inside=True),
    Cause(Fault.DRIVE_FAULT, once(fail), Y),
    Cause(Fault.DRIVE_WATCHDOG, once(trip), Y),
    Cause(Fault.DRIVE_DISABLED, once(drop_out), Y),
    Cause(Fault.ENABLE_TIMEOUT, once(_never_enabled), Y, ("safety.enable_timeout_ticks=40",), begin=0),
    Cause(Fault.BUS_PASSIVE, _wire(FaultKind.NO_ACK)),
    Cause(Fault.BUS_OFF, _wire(FaultKind.BUS_OFF)),
    Cause(Fault.NO_ACK, _wire(FaultKind.NO_ACK)),
    Cause(Fault.TRANSMIT_REFUSED, once(queue_full)),
    Cause(Fault.TRANSMIT_BLOCKED, once(queue_full)),
    Cause(Fault.INTERFACE_DOWN, _wire(FaultKind.DOWN)),
    Cause(Fault.RECEIVE_FLOOD, babble(BABBLE.can_id)),
    Cause(Fault.OVERRUN, overruns(1, last=0)),
    Cause(Fault.OVERRUN_BURST, overruns(1)),
    Cause(Fault.OVERRUN_LONG, overruns(25, last=0)),
    Cause(Fault.HEARTBEAT_LOST, _nothing, "", ("safety.heartbeat_s=0.04",), beats=BEGIN),
    Cause(Fault.REALTIME_DENIED, withdrawn("realtime_ok")),
    Cause(Fault.RECORDER_LOST, withdrawn("recorder_ok")),
    Cause(Fault.RIG_CHANGED, withdrawn("rig_ok")),
    Cause(Fault.DRIVE_STAYS_ENABLED, once(says_enabled), Y, activates=False),
    Cause(Fault.AXIS_NOT_AS_STATED, _nothing, "x", _PUSHES, begin=0, beside=("axes.x.encoder_resolution=1e-8",)),
    Cause(Fault.HOMING_FAILED, _nothing, Y, _UNHOMED, begin=0),
    Cause(Fault.FOREIGN_COMMAND, once(foreign_command)),
    Cause(Fault.ANSWERS_DIFFER, answer_twice, Y),
    Cause(Fault.STAMP, stamp_off(1_000_000), Y),
    Cause(Fault.STAMP_GLITCH, stamp_off(60_000), Y),
    Cause(Fault.STANDSTILL, once(encoder_creep), Y, activates=False),
    Cause(Fault.AXIS_MOVED, once(encoder_creep), Y, begin=8),
    Cause(Fault.LIMIT_SWITCH, status_bit(DriveStatus.LIMIT_HIGH), Y, ("axes.y.limits.switches=true",)),
    Cause(Fault.OSCILLATION, swing(0.9, 20), Y, inside=True),
    Cause(Fault.SENSOR_SILENT, falsified(silent), "force", _SENSOR),
    Cause(Fault.SENSOR_STUCK, falsified(stuck), "force", _SENSOR),
    Cause(Fault.SENSOR_RANGE, falsified(beyond), "force", _SENSOR),
    Cause(Fault.SENSOR_SEQUENCE, falsified(skipping), "force", _SENSOR),
)
_OWN = {cause.fault for cause in _CAUSES}
CAUSES = (*_CAUSES, *(Cause(fault, status_bit(bit), Y) for fault, bit in BITS.items() if fault not in _OWN))
