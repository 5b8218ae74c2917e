"""What the campaign injects, and what hil/faults.py's table says must follow.

A trial is begun on a run that has been brought to a checkpoint, may act before every later tick, and names the faults
that may be detected. Where it must be detected, and how hard the reaction must be at least, is written down here
independently of that table: a row changed by mistake must make the campaign fail.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from drivers.frame import ECHO, FD, Frame
from drivers.protocols.base import DriveStatus, Sample
from drivers.wire_faults import FaultKind, WireFault
from hil.faults import Fault, Reaction
from hil.laws.base import LawInputs
from hil.lockstep import LockstepRun
from hil.state_machine import State
from hil.tick import CommandKind

MOVING = frozenset({State.HOMING, State.ACTIVE, State.STOPPING})
WATCHING = MOVING | {State.READY}
ALWAYS = WATCHING | {State.CONNECTED}

Step = Callable[[LockstepRun, int, int], None]  # run, axis, ticks since the injection


@dataclass(frozen=True)
class Trial:
    """One kind of fault.

    step: called before every tick from the injection on (third argument 0). faults: what the detectors may see, any of
    them. within: ticks from the injection to detection, in states where one of them is armed. per_axis: repeat for
    every axis. moving_only: physics shows it only while the axis should move (a stuck encoder at rest is no fault yet).
    benign: must not change the state at all. certain: False where feedback may well master it. command: an operator's
    command the trial sends itself. armed: states in which detection is due. demand: the weakest reaction that will do.
    """

    name: str
    step: Step
    faults: tuple[Fault, ...] = ()
    within: int = 3
    per_axis: bool = True
    moving_only: bool = False
    benign: bool = False
    certain: bool = True
    armed: frozenset[State] = MOVING
    demand: Reaction = Reaction.STOP
    command: CommandKind | None = None


def _once(act: Callable[[LockstepRun, int], None]) -> Step:
    def step(run: LockstepRun, axis: int, k: int) -> None:
        if k == 0:
            act(run, axis)

    return step


def _axis_name(run: LockstepRun, axis: int) -> str:
    return run.rig.axis_names[axis]


def _wire(kind: FaultKind, ticks: int = 0, *, node: bool = True, count: int = 0, delay_ns: int = 1_000_000) -> Step:
    """A wire fault on the frames an axis sends, for `ticks` (0: for good)."""

    def act(run: LockstepRun, axis: int) -> None:
        now = run.wire.now_ns
        until = now + ticks * run.rig.period_ns if ticks else 2**61
        sender = _axis_name(run, axis) if node else None
        run.wire.inject(WireFault(kind, from_ns=now, until_ns=until, node=sender, count=count, delay_ns=delay_ns))

    return _once(act)


def _host(kind: FaultKind) -> Step:
    def act(run: LockstepRun, axis: int) -> None:
        run.wire.inject(WireFault(kind, from_ns=run.wire.now_ns, node="host"))

    return _once(act)


class _Encoder:
    """A falsified encoder. change(true count, count at the injection, ticks since) -> what it shows."""

    def __init__(self, change: Callable[[int, int, int], int]) -> None:
        self._change = change
        self._held = self._ticks = 0

    def __call__(self, run: LockstepRun, axis: int, k: int) -> None:
        self._ticks = k
        if k == 0:
            drive = run.stage.drives[axis]
            self._held = round(float(run.stage.position[axis]) / drive.resolution)
            drive.taps.append(self._falsify)

    def _falsify(self, sample: Sample) -> Sample:
        return sample._replace(position=self._change(sample.position, self._held, self._ticks))


def _status(bit: DriveStatus) -> Step:
    def act(run: LockstepRun, axis: int) -> None:
        run.stage.drives[axis].extra_status |= int(bit)

    return _once(act)


def _trip(run: LockstepRun, axis: int) -> None:
    run.stage.drives[axis].trip(run.stage.now_ns)


def _fail(run: LockstepRun, axis: int) -> None:
    run.stage.drives[axis].fail()


def _law_asks(change: Callable[[list[float], int], None]) -> Step:
    """Falsify what the law asks for, on one axis."""

    def act(run: LockstepRun, axis: int) -> None:
        law = run.cycle.law
        honest = law.force

        def force(inputs: Sequence[LawInputs]) -> list[float]:
            asked = honest(inputs)
            change(asked, axis)
            return asked

        law.force = force  # type: ignore[method-assign, assignment]

    return _once(act)


def _set(value: float) -> Callable[[list[float], int], None]:
    def change(asked: list[float], axis: int) -> None:
        asked[axis] = value

    return change


def _filter_nan(run: LockstepRun, axis: int) -> None:
    run.cycle.filters[axis].velocity = math.nan


class _Bent:
    """A trajectory that goes somewhere else on one axis."""

    def __init__(self, honest: object, axis: int, position: float, velocity: float) -> None:
        self._honest, self._axis, self._position, self._velocity = honest, axis, position, velocity

    def __getattr__(self, name: str) -> object:
        return getattr(self._honest, name)

    def at(self, axis: int, t_ns: int) -> tuple[float, float, float]:
        position, velocity, acceleration = self._honest.at(axis, t_ns)  # type: ignore[attr-defined]
        if axis != self._axis:
            return position, velocity, acceleration
        return position + self._position, velocity + self._velocity, acceleration


def _bend(position_widths: float, speeds: float) -> Step:
    """Displace the setpoint by so many travel widths, its velocity by so many speed limits."""

    def act(run: LockstepRun, axis: int) -> None:
        limits = run.rig.axes[_axis_name(run, axis)].limits
        width = limits.position[1] - limits.position[0]
        setpoints = run.cycle.setpoints
        if setpoints.trajectory is not None:
            bent = _Bent(setpoints.trajectory, axis, position_widths * width, speeds * limits.speed)
            setpoints.follow(bent, setpoints.origin)  # type: ignore[arg-type]

    return _once(act)


def _jam(run: LockstepRun, axis: int) -> None:
    run.stage.jam(axis, 1e4)


def _torque_constant(run: LockstepRun, axis: int) -> None:
    run.stage.drives[axis].gain = 1.3


def _queue_full(run: LockstepRun, axis: int) -> None:
    run.host.queue_length = 0


def _babble(run: LockstepRun, axis: int) -> None:
    fault = WireFault(FaultKind.BABBLE, from_ns=run.wire.now_ns, can_id=0x7FF, period_ns=25_000, length=0)
    run.wire.inject(fault)


def _overruns(slots: int, every: int = 1, last: int = 10_000) -> Step:
    def step(run: LockstepRun, axis: int, k: int) -> None:
        if k % every == 0 and k <= last:
            run.skip(slots)

    return step


def _forge(make: Callable[[Frame], Frame], ticks: int = 10_000) -> Step:
    """Put a foreign frame made from the axis' latest answer into the host's receive queue."""

    def step(run: LockstepRun, axis: int, k: int) -> None:
        sender = _axis_name(run, axis)
        for frame in list(run.received):
            if k < ticks and not frame.flags & ECHO and run.stage.sender_of(frame) == sender:
                run.received.append(make(frame))
                break

    return step


def _flag(name: str) -> Step:
    def act(run: LockstepRun, axis: int) -> None:
        run.grants[name] = False

    return _once(act)


def _stop_signal(run: LockstepRun, axis: int) -> None:
    run.stop = True


def _nothing(run: LockstepRun, axis: int, k: int) -> None:
    return


_GONE = (Fault.ENCODER_LOST, Fault.ENCODER_DEAD)
_STUCK = (Fault.FOLLOWING_ERROR, Fault.ENCODER_STUCK, Fault.FILTER_DIVERGED, Fault.SPEED, Fault.TRAVEL_PLANNED)
_HELD_UP = (Fault.OVERRUN_LONG, Fault.OVERRUN_BURST, Fault.DRIVE_WATCHDOG, Fault.DRIVE_DISABLED, *_GONE)

TRIALS: tuple[Trial, ...] = (
    Trial("encoder silent, 1 tick", _wire(FaultKind.DROP, count=1), benign=True),
    Trial("encoder silent, 2 ticks", _wire(FaultKind.DROP, count=2), benign=True),
    Trial("encoder silent", _wire(FaultKind.DROP), _GONE, within=11, armed=WATCHING),
    Trial("all encoders silent", _wire(FaultKind.DROP, node=False), _GONE, within=11, per_axis=False, armed=WATCHING),
    Trial("answers late by 2 ms", _wire(FaultKind.DELAY, delay_ns=2_000_000), _GONE, within=12, armed=WATCHING),
    Trial("one bad checksum", _wire(FaultKind.ALTER, count=1), benign=True),
    Trial("bad checksums", _wire(FaultKind.ALTER), (Fault.BAD_FRAMES, *_GONE), within=11, armed=WATCHING),
    Trial(
        "duplicates", _forge(lambda frame: frame), (Fault.BAD_FRAMES,), within=7, armed=WATCHING, demand=Reaction.ZERO
    ),
    Trial("one duplicate", _forge(lambda frame: frame, ticks=1), benign=True),
    Trial(
        "wrong length",
        _forge(lambda f: f._replace(data=f.data[: len(f.data) // 2])),
        (Fault.BAD_FRAMES,),
        within=7,
        armed=WATCHING,
        demand=Reaction.ZERO,
    ),
    Trial(
        "classic instead of FD, or FD instead of classic",
        _forge(lambda f: f._replace(flags=f.flags ^ FD)),
        (Fault.BAD_FRAMES,),
        within=7,
        armed=WATCHING,
        demand=Reaction.ZERO,
    ),
    Trial("foreign traffic on other identifiers", _forge(lambda f: f._replace(can_id=0x321)), benign=True),
    Trial("answers overtaken by others", _wire(FaultKind.REORDER, delay_ns=900_000), _GONE, certain=False),
    Trial("bit errors on the wire", _wire(FaultKind.CORRUPT, count=1), benign=True),
    Trial("encoder glitch", _Encoder(lambda count, held, k: count + (10**7 if k == 0 else 0)), benign=True),
    Trial(
        "encoder jump",
        _Encoder(lambda count, held, k: count + 10**7),
        (Fault.ENCODER_JUMP,),
        within=4,
        armed=WATCHING,
        demand=Reaction.ZERO,
    ),
    Trial(
        "encoder noise",
        _Encoder(lambda count, held, k: count + (-1) ** k * 10**7),
        (Fault.ENCODER_JUMP,),
        within=4,
        armed=WATCHING,
        demand=Reaction.ZERO,
    ),
    Trial("encoder stuck", _Encoder(lambda count, held, k: held), _STUCK, within=600, moving_only=True),
    Trial("encoder reversed", _Encoder(lambda count, held, k: 2 * held - count), _STUCK, within=600, moving_only=True),
    Trial("drive fault bit", _status(DriveStatus.FAULT), (Fault.DRIVE_FAULT,), armed=WATCHING, demand=Reaction.ZERO),
    Trial(
        "drive encoder fault bit",
        _status(DriveStatus.ENCODER_FAULT),
        (Fault.ENCODER_FAULT,),
        armed=WATCHING,
        demand=Reaction.ZERO,
    ),
    Trial("drive fails", _once(_fail), (Fault.DRIVE_FAULT,), armed=WATCHING, demand=Reaction.ZERO),
    Trial("drive watchdog trips", _once(_trip), (Fault.DRIVE_WATCHDOG,), armed=WATCHING, demand=Reaction.ZERO),
    Trial("axis jammed", _once(_jam), _STUCK, within=600, moving_only=True),
    Trial("torque constant 30 % high", _once(_torque_constant), _STUCK, certain=False),
    Trial(
        "law asks for NaN",
        _law_asks(_set(np.nan)),
        (Fault.NOT_FINITE,),
        within=1,
        armed=frozenset({State.HOMING, State.ACTIVE}),
        demand=Reaction.ZERO,
    ),
    Trial(
        "law asks for infinity",
        _law_asks(_set(np.inf)),
        (Fault.NOT_FINITE,),
        within=1,
        armed=frozenset({State.HOMING, State.ACTIVE}),
        demand=Reaction.ZERO,
    ),
    Trial("law asks for 1e9", _law_asks(_set(1e9)), (*_STUCK, Fault.TRAVEL), within=600, moving_only=True),
    Trial("filter turns NaN", _once(_filter_nan), (Fault.NOT_FINITE, Fault.SPEED), within=2, demand=Reaction.ZERO),
    Trial(
        "setpoint leaves the travel",
        _bend(2.0, 0.0),
        (Fault.TRAVEL_PLANNED, Fault.FOLLOWING_ERROR),
        within=2,
        armed=frozenset({State.HOMING, State.ACTIVE}),
    ),
    Trial(
        "setpoint too fast",
        _bend(0.0, 3.0),
        (Fault.SPEED_PLANNED,),
        within=2,
        armed=frozenset({State.HOMING, State.ACTIVE}),
    ),
    Trial(
        "setpoint jumps",
        _bend(0.2, 0.0),
        (Fault.FOLLOWING_ERROR, Fault.TRAVEL_PLANNED),
        within=2,
        armed=frozenset({State.HOMING, State.ACTIVE}),
    ),
    Trial("bus-off", _host(FaultKind.BUS_OFF), (Fault.BUS_OFF,), per_axis=False, armed=ALWAYS, demand=Reaction.SILENT),
    Trial(
        "no acknowledgement", _host(FaultKind.NO_ACK), (Fault.NO_ACK, *_GONE), within=4, per_axis=False, armed=WATCHING
    ),
    Trial(
        "interface down",
        _host(FaultKind.DOWN),
        (Fault.INTERFACE_DOWN,),
        per_axis=False,
        armed=ALWAYS,
        demand=Reaction.SILENT,
    ),
    Trial(
        "transmit queue full",
        _once(_queue_full),
        (Fault.TRANSMIT_BLOCKED, *_GONE),
        within=5,
        per_axis=False,
        armed=WATCHING,
    ),
    Trial("babbling node", _once(_babble), (Fault.RECEIVE_FLOOD,), within=3, per_axis=False, armed=ALWAYS),
    Trial("one overrun", _overruns(1, last=0), benign=True, per_axis=False),
    Trial("every other slot missed", _overruns(1), (Fault.OVERRUN_BURST,), within=6, per_axis=False),
    Trial("held up for 25 ms", _overruns(25, last=0), _HELD_UP, within=2, per_axis=False),
    Trial("recorder lost", _flag("recorder_ok"), benign=True, per_axis=False),
    Trial("rig file changed", _flag("rig_ok"), benign=True, per_axis=False),
    Trial("termination signal", _once(_stop_signal), per_axis=False),
    Trial("emergency stop", _nothing, per_axis=False, command=CommandKind.ESTOP),
    Trial("activate in the wrong state", _nothing, per_axis=False, command=CommandKind.ACTIVATE),
    Trial("reset in the wrong state", _nothing, per_axis=False, command=CommandKind.RESET),
    Trial("operator stops", _nothing, per_axis=False, command=CommandKind.STOP),
)
