"""How the campaign's faults are brought about: steps of trials (trial.py) on a lockstep run."""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

from drivers.families.cia402 import cia301
from drivers.families.cia402.cia301 import DriveState
from drivers.frame import ECHO, Frame
from drivers.protocols import device_protocol
from drivers.protocols.base import Command, DriveStatus, Sample, fixed_bits
from drivers.wire.faults import FaultKind, WireFault
from hil.control.estimator.gains import design_gains
from hil.control.laws.base import AxisLaws, LawInputs
from hil.control.trajectories.displaced import Displaced
from hil.cycle.limits import axis_limits
from hil.rig.bus_load import feedback_ns
from hil.rig.layout import host_layout
from hil.studies.fault_campaign.trial import Step, axis_name, once
from hil.virtual.lockstep import LockstepRun
from sim_plant.drives.canopen_drive import Cia402Drive
from sim_plant.drives.object_dictionary import key_of


def axis_frames(
    kind: FaultKind, *, node: bool = True, count: int = 0, delay_ns: int = 1_000_000, bit: int = -1
) -> Step:
    """A wire fault on the frames an axis sends: on `count` of them, or on all from now on; on everybody's without
    `node`.
    """

    def act(run: LockstepRun, axis: int) -> None:
        sender = axis_name(run, axis) if node else None
        now = run.wire.now_ns
        run.wire.inject(WireFault(kind, from_ns=now, node=sender, count=count, delay_ns=delay_ns, bit=bit))

    return once(act)


class Encoder:
    """A falsified encoder. change(true count, count at the injection, ticks since) -> what it shows."""

    def __init__(self, change: Callable[[int, int, int], int]) -> None:
        self._change = change
        self._held = self._ticks = 0

    def __call__(self, run: LockstepRun, axis: int, k: int) -> None:
        """The step."""
        self._ticks = k
        if k == 0:
            drive = run.stage.drives[axis]
            self._held = round(float(run.stage.position[axis]) / drive.resolution)
            drive.taps.append(self._falsify)

    def _falsify(self, sample: Sample) -> Sample:
        return replace(sample, position=self._change(sample.position, self._held, self._ticks))


def encoder_creep(run: LockstepRun, axis: int) -> None:
    """By its encoder the axis goes a window of rest further in every tick."""
    drive, begin = run.stage.drives[axis], run.index
    counts = round(axis_limits(run.rig)[axis].rest_window / drive.resolution) + 1
    drive.taps.append(lambda sample: replace(sample, position=sample.position + counts * (1 + run.index - begin)))


def status_bit(bit: DriveStatus) -> Step:
    """The drive shows a bit of its status, from now on."""

    def act(run: LockstepRun, axis: int) -> None:
        run.stage.drives[axis].extra_status |= int(bit)

    return once(act)


def foreign_command(run: LockstepRun, axis: int) -> None:
    """Another node sends the host's command, once: full force on every axis."""
    limits = [axis.limits.force for axis in run.rig.axes.values()]
    other = host_layout(run.rig, run.base_dir)
    frames = other.encode(Command(run.cycle.sent_sequence + 1, limits, (1 << len(limits)) - 1, False))
    node = run.wire_of(axis).attach("another host", None)
    for frame in frames:  # not while ours is on the wire: two frames of one identifier at once are a bus error
        node.send(frame, run.wire.now_ns + run.rig.period_ns // 2)


def answer_twice(run: LockstepRun, axis: int, k: int) -> None:
    """Another node answers as the axis' drive does, a millimetre or so beside it."""
    for frame in list(run.received):
        sample = run.cycle.protocol.decode(frame)
        if isinstance(sample, Sample) and sample.axis == axis:
            device = device_protocol(
                run.rig.bus, len(run.rig.axes), [a.rated_force for a in run.rig.axes.values()], run.base_dir
            )
            beside = replace(sample, position=sample.position + 1000)
            run.received.append(device.encode_feedback(beside)._replace(timestamp_ns=frame.timestamp_ns))
            return


def stamp_off(ns: int) -> Step:
    """The drive's clock is off by so much, from now on."""

    def act(run: LockstepRun, axis: int) -> None:
        run.stage.drives[axis].taps.append(lambda sample: replace(sample, stamp_ns=sample.stamp_ns + ns))

    return once(act)


def trip(run: LockstepRun, axis: int) -> None:
    """The drive's watchdog expires."""
    run.stage.drives[axis].trip(run.stage.now_ns)


def fail(run: LockstepRun, axis: int) -> None:
    """The drive finds a fault."""
    run.stage.drives[axis].fail()


class _Falsified:
    """A law whose requested force is falsified on one axis."""

    def __init__(self, honest: AxisLaws, change: Callable[[list[float], int], None], axis: int) -> None:
        self._honest, self._change, self._axis = honest, change, axis
        self.reset = honest.reset

    def force(self, axes: Sequence[LawInputs]) -> list[float]:
        """See AxisLaws."""
        asked = self._honest.force(axes)
        self._change(asked, self._axis)
        return asked

    @property
    def failure(self) -> str:
        """See AxisLaws."""
        return self._honest.failure

    @property
    def denominator_floors(self) -> int:
        """See AxisLaws."""
        return self._honest.denominator_floors


def law_asks(change: Callable[[list[float], int], None]) -> Step:
    """Falsify what the law asks for, on one axis."""

    def act(run: LockstepRun, axis: int) -> None:
        run.cycle.law = _Falsified(run.cycle.law, change, axis)

    return once(act)


def set_to(value: float) -> Callable[[list[float], int], None]:
    """What `law_asks` makes of one axis' force: this value, N."""

    def change(asked: list[float], axis: int) -> None:
        asked[axis] = value

    return change


def swing(share: float, ticks: int) -> Step:
    """A share of the force limit on top of what the law asks, of another sign every so many ticks."""

    def step(run: LockstepRun, axis: int, k: int) -> None:
        force = share * run.rig.axes[axis_name(run, axis)].limits.force

        def change(asked: list[float], at: int) -> None:
            asked[at] += math.copysign(force, ticks - 1 - run.index % (2 * ticks))

        if k == 0:
            run.cycle.law = _Falsified(run.cycle.law, change, axis)

    return step


def filter_nan(run: LockstepRun, axis: int) -> None:
    """The axis' estimated velocity is no number any more."""
    run.cycle.filters[axis].velocity = math.nan


def disbelieve(run: LockstepRun, axis: int, k: int) -> None:
    """The axis' filter expects each sample twice the limit beside where it is, to and fro. Its state is set so that its
    correction brings velocity and disturbance back to what they were: nothing else is to be seen of it.
    """
    motion, interval = run.cycle.filters[axis], _next_interval(run, axis) * 1e-9
    longer = interval * 1e9 / run.rig.period_ns
    stretch = longer if 2.0 * longer > 3.0 else 1.0  # as hil/cycle/sampling.py tells the filter
    error = (-1) ** k * 2.0 * run.cycle.axes.innovation_limit[axis]
    _, velocity_gain, disturbance_gain = design_gains(run.rig)[0][:, axis].tolist()
    mass = run.cycle.axes.models[axis].mass
    slowed = disturbance_gain * error / stretch**2 * interval / mass  # m/s, by the disturbance, in an interval
    faster = velocity_gain * error / stretch + slowed
    motion.position += error - faster * interval + 0.5 * slowed * interval
    motion.velocity += faster
    motion.disturbance += disturbance_gain * error / stretch**2


def _next_interval(run: LockstepRun, axis: int) -> int:
    """From the axis' last sample to the next one, ns. Drives that send in their own time, which does not divide the
    rig's period, send once or more often between two ticks; the latest that arrives in time counts.
    """
    period, feedback = run.rig.period_ns, feedback_ns(run.cycle.protocol)
    if not feedback or period % feedback == 0:
        return period
    sampled = run.cycle.sampling.clocks[axis].instant
    on_the_way = run.cycle.inbox.received_ns[axis] - sampled
    return max(1, (run.index * period - sampled - on_the_way) // feedback) * feedback


def bend(position_widths: float, speeds: float) -> Step:
    """Displace the setpoint by so many travel widths, its velocity by so many speed limits."""

    def act(run: LockstepRun, axis: int) -> None:
        limits = run.rig.axes[axis_name(run, axis)].limits
        width = limits.position[1] - limits.position[0]
        setpoints = run.cycle.setpoints
        if setpoints.trajectory is not None:
            position, velocity = position_widths * width, speeds * limits.speed
            displaced = Displaced(setpoints.trajectory, len(run.rig.axes), axis, position, velocity)
            setpoints.follow(displaced, setpoints.origin)

    return once(act)


def says_enabled(run: LockstepRun, axis: int) -> None:
    """The drive says that it is enabled, whatever it is told."""
    drive = run.stage.drives[axis]
    drive.taps.append(lambda sample: replace(sample, status=sample.status | int(DriveStatus.ENABLED)))
    node = run.stage.nodes[axis] if run.stage.nodes else None
    if isinstance(node, Cia402Drive):  # it tells its own state
        _, enabled = DriveState.OPERATION_ENABLED.value
        node.dictionary.getters[key_of(cia301.STATUSWORD)] = lambda: enabled


def jam(run: LockstepRun, axis: int) -> None:
    """The axis is held by more force than any drive has."""
    run.stage.jam(axis, 1e4)


def torque_constant(run: LockstepRun, axis: int) -> None:
    """The drive's force is 30 % more than it is told."""
    run.stage.drives[axis].gain = 1.3


def queue_full(run: LockstepRun, axis: int) -> None:
    """The host's transmit queue takes nothing any more."""
    run.host.queue_length = 0


def babble(*can_ids: int) -> Step:
    """A node sends without a pause: an empty frame every 25 us, of which none is over in less than 47. With the first
    of the identifiers that no message of the rig's has.
    """

    def act(run: LockstepRun, axis: int) -> None:
        now = run.wire.now_ns
        taken = {message.can_id for message in run.cycle.protocol.messages(run.rig.period_ns)}
        can_id = next(can_id for can_id in can_ids if can_id not in taken)
        run.wire.inject(WireFault(FaultKind.BABBLE, from_ns=now, can_id=can_id, period_ns=25_000, length=0))

    return once(act)


def drop_out(run: LockstepRun, axis: int) -> None:
    """The drive is enabled no more, and says so, without a fault."""
    drive = run.stage.drives[axis]
    drive.taps.append(lambda sample: replace(sample, status=sample.status & ~int(DriveStatus.ENABLED)))
    node = run.stage.nodes[axis] if run.stage.nodes else None
    if isinstance(node, Cia402Drive):  # it tells its own state
        node.switch_off()


def overruns(slots: int, last: int = 10_000) -> Step:
    """The control process misses `slots` slots before every tick up to tick `last`."""

    def step(run: LockstepRun, axis: int, k: int) -> None:
        if k <= last:
            run.skip(slots)

    return step


def is_answer(run: LockstepRun, axis: int) -> Callable[[Frame], bool]:
    """Whether a frame is a cyclic answer of the axis' drive."""
    answers = run.cycle.protocol.messages(run.rig.period_ns)
    cyclic = next(m for m in answers if m.period_ns <= run.rig.period_ns and m.sender == f"axis {axis}")
    _, mask = fixed_bits(run.cycle.protocol)
    return lambda frame: not frame.flags & ECHO and not (frame.can_id ^ cyclic.can_id) & mask


def forge(make: Callable[[Frame], Frame], ticks: int = 10_000) -> Step:
    """Put a foreign frame made from the axis' latest answer into the host's receive queue."""

    def step(run: LockstepRun, axis: int, k: int) -> None:
        ours = is_answer(run, axis)
        for frame in list(run.received):
            if k < ticks and ours(frame):
                run.received.append(make(frame))
                break

    return step


def withdrawn(name: str) -> Step:
    """A grant (hil.cycle.tick.Tick) is taken back."""

    def act(run: LockstepRun, axis: int) -> None:
        run.grants[name] = False

    return once(act)


def stop_signal(run: LockstepRun, axis: int) -> None:
    """SIGTERM."""
    run.stop = True


def stop_pressed(run: LockstepRun, axis: int) -> None:
    """Somebody presses stop (hil estop)."""
    run.estop = True
