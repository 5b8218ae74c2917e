"""What may happen while the tip is in a cell, and what the rig must do then: by the reaction that is demanded."""

import math
from collections.abc import Callable
from dataclasses import dataclass

from drivers.frame import Frame
from drivers.protocols.base import DriveStatus
from drivers.wire.faults import FaultKind
from hil.control.motion.contract import References
from hil.cycle.fault_table import Fault, Reaction
from hil.cycle.state_machine import State
from hil.cycle.tick import CommandKind
from hil.studies.fault_campaign.checkpoints import CampaignRun
from hil.studies.fault_campaign.injections import axis_frames, bend, overruns, status_bit, withdrawn
from hil.studies.fault_campaign.trial import Step, host_frames
from sim_plant.nodes.sensor import SensorNode, Tap, silent, stuck, tapped

_FOREIGN = 0x321  # an identifier that nobody has
_CAMERA = ("shift", "tip", "bolus")


@dataclass(frozen=True)
class Happening:
    """One thing that happens, from a tick on.

    step: called before every tick from then on, on the axis of the injection or, with `across`, on one across it.
    reaction: demanded. ends: the state then. faults: one of which latches; empty: none. clears: what the motion does
    itself ends the injection: the tip is then out of the cell, if not at its safe height. held_outside: a rig whose
    tip is not inside stays ACTIVE. command: the operator's.
    """

    name: str
    step: Step
    reaction: Reaction
    ends: State
    faults: tuple[Fault, ...] = ()
    across: bool = False
    clears: bool = False
    held_outside: bool = False
    command: CommandKind | None = None


def _nothing(run: CampaignRun, axis: int, k: int) -> None:
    """Of what is but a command."""


def _sensors(run: CampaignRun, *keys: str) -> list[SensorNode]:
    """Those that the motion knows by these keys of its parameters."""
    given = run.rig.motion.parameters
    names = [given.get(key, "force" if key == "force" else "") for key in keys]
    return [node for name, node in zip(run.rig.sensors, run.stage.sensors, strict=True) if name in names]


def _sensor(tap_of: Callable[[SensorNode], Tap], *keys: str) -> Step:
    """What these sensors send goes through a tap, from now on."""

    def act(run: CampaignRun, axis: int, k: int) -> None:
        if k == 0:
            tapped(_sensors(run, *keys), tap_of)

    return act


def _motion(answer: Callable[[int], object]) -> Step:
    """The motion answers that from now on, by the number of axes."""

    def act(run: CampaignRun, axis: int, k: int) -> None:
        decided = run.cycle.supervisor.goals.decided
        if k == 0 and decided is not None:
            decided.motion.step = lambda seen: answer(len(seen.position))

    return act


def _not_finite(n: int) -> References:
    return References([math.nan] * n, [0.0] * n)


def _flood(run: CampaignRun, axis: int, k: int) -> None:
    """Another node's frames, as many in a tick as are a flood."""
    run.received += [Frame(_FOREIGN, b"", 0, run.wire.now_ns)] * run.rig.safety.flood_frames


def _signal(run: CampaignRun, axis: int, k: int) -> None:
    run.stop = True


def _press(run: CampaignRun, axis: int, k: int) -> None:
    run.estop = k == 0


_LED_OUT = (
    Happening("operator stops", _nothing, Reaction.WITHDRAW, State.READY, command=CommandKind.STOP),
    Happening("termination signal", _signal, Reaction.WITHDRAW, State.SHUTDOWN),
    Happening("motion raises", _motion(lambda n: 1 // 0), Reaction.WITHDRAW, State.READY, held_outside=True),
    Happening("motion answers NaN", _motion(_not_finite), Reaction.WITHDRAW, State.READY, held_outside=True),
    Happening("motion answers nothing", _motion(lambda n: None), Reaction.WITHDRAW, State.READY, held_outside=True),
    Happening(
        "force sensor silent", _sensor(silent, "force"), Reaction.WITHDRAW, State.FAULT, (Fault.SENSOR_SILENT,)
    ),
    Happening("force sensor stuck", _sensor(stuck, "force"), Reaction.WITHDRAW, State.FAULT, (Fault.SENSOR_STUCK,)),
    Happening("flood of foreign frames", _flood, Reaction.WITHDRAW, State.FAULT, (Fault.RECEIVE_FLOOD,)),
    Happening(
        "setpoint of another axis jumps", bend(0.02, 0.0), Reaction.WITHDRAW, State.FAULT, (Fault.FOLLOWING_ERROR,),
        across=True,
    ),
    Happening("encoder silent, 1 tick", axis_frames(FaultKind.DROP, count=1), Reaction.BRIDGE, State.ACTIVE),
    Happening("camera frozen", _sensor(silent, *_CAMERA), Reaction.COUNT, State.ACTIVE, clears=True),
    Happening("recorder lost, as its disk is full", withdrawn("recorder_ok"), Reaction.COUNT, State.ACTIVE),
)  # fmt: skip
_LEFT_INSIDE = (
    Happening(
        "encoder silent", axis_frames(FaultKind.DROP), Reaction.STOP, State.FAULT, (Fault.ENCODER_LOST,), across=True
    ),
    Happening("every other slot missed", overruns(1), Reaction.STOP, State.FAULT, (Fault.OVERRUN_BURST,)),
    Happening("setpoint jumps", bend(0.1, 0.0), Reaction.STOP, State.FAULT, (Fault.FOLLOWING_ERROR,)),
    Happening(
        "drive fault bit", status_bit(DriveStatus.FAULT), Reaction.ZERO, State.FAULT, (Fault.DRIVE_FAULT,), across=True
    ),
    Happening("bus-off", host_frames(FaultKind.BUS_OFF), Reaction.SILENT, State.FAULT, (Fault.BUS_OFF,)),
    Happening("interface down", host_frames(FaultKind.DOWN), Reaction.SILENT, State.FAULT, (Fault.INTERFACE_DOWN,)),
    Happening("emergency stop", _nothing, Reaction.ZERO, State.ESTOP, command=CommandKind.ESTOP),
    Happening("stop line", _press, Reaction.ZERO, State.ESTOP),
)
HAPPENINGS = (*_LED_OUT, *_LEFT_INSIDE)
