"""One kind of fault that the campaign injects, and what is demanded then."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

from drivers.wire.faults import FOREVER_NS, FaultKind, WireFault
from hil.cycle.fault_table import Fault, Reaction
from hil.cycle.state_machine import State
from hil.cycle.tick import CommandKind
from hil.rig.schema import RigConfig
from hil.studies.fault_campaign.checkpoints import CampaignRun
from hil.studies.fault_campaign.layout_capabilities import NONE, Capability
from hil.virtual.lockstep import LockstepRun

MOVING = frozenset({State.HOMING, State.ACTIVE, State.STOPPING})
WATCHING = MOVING | {State.READY}
ALWAYS = WATCHING | {State.CONNECTED}

GONE = (Fault.ENCODER_LOST, Fault.ENCODER_DEAD)


def silence(state: State) -> Fault:
    """What silence is called in a state: while torque is permitted it is noticed sooner."""
    return Fault.ENCODER_LOST if state in MOVING else Fault.ENCODER_DEAD


# What shows of a drive that says nothing of itself: its axis does not do as it is told.
BY_MOTION = (
    Fault.FOLLOWING_ERROR,
    Fault.ENCODER_STUCK,
    Fault.FILTER_DIVERGED,
    Fault.SPEED,
    Fault.TRAVEL_PLANNED,
    Fault.TRAVEL,
    Fault.OSCILLATION,
)
Step = Callable[[CampaignRun, int, int], None]  # run, axis, ticks since the injection
Limit = int | Callable[[RigConfig], int]
PROMPT = 2  # ticks, from where a bound is left to the fault that says so


@dataclass(frozen=True)
class Trial:
    """One kind of fault.

    step: called before every tick from the injection on (third argument 0). faults: what the detectors may flag,
    any of them. within: ticks from the injection to detection, in states where one of them is armed. bounds: of
    faults that wait for a number of ticks that the rig states: they are due within PROMPT ticks of the last one.
    per_axis: repeat for every axis. moving_only: physics shows it only while the axis should move (a stuck encoder
    at rest is no fault yet). following_only: it falsifies the task, or the drives that follow it, so there has to
    be one that runs. resting_only: tried only in states without torque, as in the others axes may move. law: it
    falsifies what the law asks for, which nobody asks before axes have been pushed as the rig says. benign: must
    not change the state at all. certain: False where feedback may well master it. command: an operator's command
    the trial sends itself. armed: states in which detection is due. demand: the weakest reaction that will do.
    exactly: by the state it began in, the one of `faults` that it must be where detection is due and the layout can
    tell; not asked of STOPPING, which may be over first. slack: ticks more than usual until the drives have let go,
    where they do not hear the host. watch: ticks more than usual in which the run has to end where it must.
    unready: whether, as the run stands at the injection, the rig must not become READY any more. ends: states one
    of which the run has to end in where no fault latched; without it they follow from the state it began in and the
    command. staged: it is of a stage that is not ideal, and tried at rest and once in motion only. few: tried there
    only, on any stage. inputs: it is of a rig with limit switches. sensors: of one with [sensors].

    Layouts differ. only: what a layout must have for the fault to be there at all. needs: what it must have for the
    fault to be told from the truth; without it `instead` may latch as well, and where `unseen` is set, detection is not
    due. Of drives without states only the motion is seen, if at all, and where they are `deaf` to what the host says
    they are not asked to let go. unheld: nor are drives without a checksum, as no order to stop arrives undamaged, and
    a damaged one may be an order to start; they apply no force all the same. lacking: what was missing of it.
    """

    name: str
    step: Step
    faults: tuple[Fault, ...] = ()
    within: Limit = 3
    bounds: Mapping[Fault, Callable[[RigConfig], int]] = field(default_factory=dict)
    per_axis: bool = True
    moving_only: bool = False
    following_only: bool = False
    resting_only: bool = False
    law: bool = False
    benign: bool = False
    certain: bool = True
    armed: frozenset[State] = MOVING
    demand: Reaction = Reaction.STOP
    command: CommandKind | None = None
    exactly: Callable[[State], Fault] | None = None
    slack: Limit = 0
    watch: Limit = 0
    unready: Callable[[LockstepRun, int], bool] | None = None
    ends: Callable[[CampaignRun], set[State]] | None = None
    staged: bool = False
    few: bool = False
    inputs: bool = False
    sensors: bool = False
    only: Capability = NONE
    needs: Capability = NONE
    instead: tuple[Fault, ...] = ()
    unseen: bool = True
    deaf: bool = False
    unheld: bool = False
    lacking: Capability = NONE

    def allowed(self, fault: Fault, rig: RigConfig) -> int:
        """Ticks from the injection within which this fault is due; its tick counts from 0."""
        bound = self.bounds.get(fault)
        return ticks(self.within, rig) if bound is None else bound(rig) - 1 + PROMPT

    def over(self, capabilities: Capability) -> "Trial":
        """The same under a layout with these capabilities."""
        lacking = self.needs & ~capabilities
        if not lacking:
            return replace(self, deaf=False, unheld=False)
        stateless = bool(lacking & Capability.STATE)
        return replace(
            self,
            faults=(*self.faults, *self.instead, *(BY_MOTION if stateless else ())),
            certain=self.certain and not (self.unseen or stateless),
            deaf=self.deaf and stateless,
            unheld=self.unheld and bool(lacking & Capability.CHECKSUM),
            exactly=None,
            benign=False,
            lacking=lacking,
        )


def ticks(limit: Limit, rig: RigConfig) -> int:
    """A limit on that rig."""
    return limit if isinstance(limit, int) else limit(rig)


def once(act: Callable[[LockstepRun, int], None]) -> Step:
    """A step that acts at the injection only."""

    def step(run: CampaignRun, axis: int, k: int) -> None:
        if k == 0:
            act(run, axis)

    return step


def axis_name(run: LockstepRun, axis: int) -> str:
    """Name of the axis, and of its node on the wire."""
    return run.rig.axis_names[axis]


def nothing(run: LockstepRun, axis: int, k: int) -> None:
    """The step of a trial that is but a command."""


def host_frames(kind: FaultKind, *, can_id: int | None = None, count: int = 0, during: int = 0, bit: int = -1) -> Step:
    """A wire fault on what the host sends: on `count` frames, on those of `during` ticks, or on all from now on. Or of
    its node, where the kind is one of a node's.
    """

    def act(run: LockstepRun, axis: int) -> None:
        now = run.wire.now_ns
        until = now + during * run.rig.period_ns if during else FOREVER_NS
        run.wire.inject(WireFault(kind, from_ns=now, until_ns=until, node="host", can_id=can_id, count=count, bit=bit))

    return once(act)


def periods(seconds: float, rig: RigConfig) -> int:
    """Control periods in which that much time is over."""
    return -(-round(seconds * 1e9) // rig.period_ns)


def watchdog(rig: RigConfig) -> int:
    """Ticks after the last command by which a drive has let go by itself."""
    return periods(rig.drives.watchdog_s, rig) + 1


def disable_timeout(rig: RigConfig) -> int:
    """Ticks by which the host knows that a drive stays enabled."""
    return rig.safety.disable_timeout_ticks + 2
