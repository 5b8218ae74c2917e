"""The emulated stage on a bus: physics and drives as one function of received frames and time; no I/O, no clock.

At the reception of a command frame all drives sample their encoders, answer, and from that instant apply the new
forces.
"""

from collections.abc import Callable, Sequence
from functools import partial
from heapq import heappop, heappush
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from drivers.config import BusConfig, DrivesConfig
from drivers.frame import SEGMENT, Frame, segment_of
from drivers.protocols.base import Command, DriveStatus, Reject, Sample
from drivers.protocols.mounting import Mounting, is_straight
from drivers.protocols.segments import segments_of
from sim_plant.config import PlantConfig, diverged
from sim_plant.drives.installed import SPOKEN, DriveNode, installed_drives, installed_mountings, installed_servos
from sim_plant.drives.lines import AllBut, Lines
from sim_plant.drives.servo import NEVER_NS
from sim_plant.drives.sides import drives_side
from sim_plant.nodes.output import OutputNode
from sim_plant.nodes.outputs import OutputNodes
from sim_plant.nodes.sensor import SensorNode
from sim_plant.physics.dish import Dish
from sim_plant.physics.stage import Truth, per_axis_array
from sim_plant.user_stage import stage_of

Array = NDArray[np.float64]

_BRAKE = int(DriveStatus.BRAKE)
_LONGEST_NS = 100_000_000  # of one integration: what `position` has to make up for stays bounded


class EmulatedStage:
    """Stage and drives behind one of the frame layouts.

    plant: the truth. bus: layout and identifiers. axis_names: in bus order. rated_force: N per axis, the drives' data
    sheet. base_dir: where the rig file is (for a relative dbc path). start_ns: the clock's first value. drives: their
    watchdog and brakes. mountings: of the drives on their axes; none: all straight. sensors, outputs: nodes beside the
    drives.

    now_ns: time reached. fd: the layout uses CAN FD frames. commands: command frames obeyed. rejected: received frames
    that carried no command, by reason. sampled: truth (positions in m, velocities in m/s) at the latest sampling,
    before the encoder; replaced by the next, not changed. acceptance: identifiers the drives listen to. frame_taps:
    what every frame of a drive goes through (fault injection). dish: the cells of [plant.dish]; None: there are none.
    Raises ValueError for a plant or bus that does not fit.
    """

    def __init__(
        self,
        plant: PlantConfig,
        bus: BusConfig,
        axis_names: Sequence[str],
        rated_force: Sequence[float],
        base_dir: Path,
        start_ns: int = 0,
        *,
        drives: DrivesConfig | None = None,
        mountings: Sequence[Mounting] = (),
        sensors: Sequence[SensorNode] = (),
        outputs: Sequence[OutputNode] = (),
    ) -> None:
        n_axes = len(axis_names)
        mountings = installed_mountings(plant.drive, n_axes) or mountings
        self._mountings = [] if is_straight(mountings) else list(mountings)
        if self._mountings:
            rated_force = [force / mounting.gear for force, mounting in zip(rated_force, mountings, strict=True)]
        self.axis_names = list(axis_names)
        self.now_ns = self._physics_ns = start_ns
        self.commands = 0
        self.rejected: dict[Reject, int] = dict.fromkeys(Reject, 0)
        self._lines = Lines(axis_names, [axes for axes, _ in segments_of(bus, n_axes)])
        self.frame_taps = self._lines.taps
        nodes = bus.protocol in SPOKEN.values() or plant.drive is not None
        self._protocol = None if nodes else drives_side(bus, n_axes, rated_force, base_dir)
        self._frames_of = getattr(self._protocol, "frames_of", self._feedback_alone)
        self._decode = getattr(self._protocol, "decode_part", getattr(self._protocol, "decode_command", None))
        self._stage = stage_of(
            plant,
            Truth.from_config(plant, n_axes, axis_names),
            per_axis_array("plant.initial_position", plant.initial_position, n_axes),
        )
        self.dish = Dish(plant.dish, axis_names) if plant.dish else None
        self.outputs = OutputNodes(outputs)
        modulus = int(getattr(self._protocol, "sequence_modulus", 0))
        self.drives = installed_servos(plant, drives or DrivesConfig(), axis_names, rated_force, modulus)
        positions = [partial(self._position_at_drive, axis) for axis in range(n_axes)]
        self._nodes = installed_drives(bus, plant.drive, base_dir, self.drives, positions, start_ns) if nodes else []
        self.fd = bool(getattr(self._protocol, "fd", False)) or True in [node.fd for node in self._nodes]
        self._brake_force = per_axis_array("plant.brake_force", plant.brake_force, n_axes).tolist()
        self._jam, self._push, self._force = [0.0] * n_axes, [0.0] * n_axes, [0.0] * n_axes
        self.sampled = self._stage.positions, self._stage.velocities
        self.sensors = list(sensors)
        self._lines.senders.update({can_id: sensor.name for sensor in sensors for can_id in sensor.can_ids})
        self._lines.senders.update(self.outputs.senders)
        shared = frozenset(node.node_id for node in self._nodes if getattr(node, "answers_as_asked", False))
        self.acceptance = AllBut(self._lines.senders, shared)
        self._agenda: list[tuple[int, int, Callable[[], None]]] = []
        self._planned = 0
        self._clamp: list[float] = []
        self._deadline_ns = NEVER_NS
        self._update()

    # what is true ----------------------------------------------------------------------------------------------------

    @property
    def position(self) -> Array:
        """True position now, m, (n_axes,). Looking changes nothing, not even the rounding of what follows."""
        return self._truth_now()[0]

    @property
    def velocity(self) -> Array:
        """True velocity now, m/s, (n_axes,)."""
        return self._truth_now()[1]

    @property
    def pierced(self) -> Array:
        """1.0 where the axis' cell is pierced, (n_axes,)."""
        return self._truth_now()[2]

    @property
    def applied_force(self) -> list[float]:
        """Force each drive applies now, N."""
        forces = [drive.force for drive in self.drives]
        if self._mountings:
            return [mounting.force_at_axis(f) for mounting, f in zip(self._mountings, forces, strict=True)]
        return forces

    @property
    def tips(self) -> tuple[list[float], list[float], list[float]]:
        """Positions (m) and velocities (m/s) of the tips when physics was last run, and 1.0 where a cell is pierced."""
        pierced: list[float] = self._stage.pierced.tolist()
        return self._stage.positions, self._stage.velocities, pierced

    @property
    def truth(self) -> Truth:
        """What the stage is like."""
        return self._stage.truth

    @property
    def nodes(self) -> Sequence[DriveNode]:
        """The drives that are nodes of their own, in axis order; empty where they are as the layout says."""
        return self._nodes

    @property
    def speaks_unasked(self) -> bool:
        """Whether `advance` may return frames: drives that are nodes of their own, and sensors."""
        return bool(self._nodes) or bool(self.sensors)

    @property
    def speaks_ns(self) -> int:
        """When a node that sends in its own time has something to say; NEVER_NS where there is none."""
        due_ns = min((node.next_ns for node in self._nodes), default=NEVER_NS)
        if self.sensors:
            due_ns = min(due_ns, min(sensor.next_ns for sensor in self.sensors))
        return due_ns

    @property
    def deadline_ns(self) -> int:
        """When the next drive watchdog expires, planned action or frame is due; NEVER_NS where nothing is."""
        return min(self._deadline_ns, self.speaks_ns)

    def _truth_now(self) -> tuple[Array, Array, Array]:
        return self._stage.peek(self.now_ns - self._physics_ns, self._all_forces())

    def _all_forces(self) -> list[float]:
        """On the axes now, that of a cell among them, N."""
        return self._force if self.dish is None else self.dish.loaded(self._force)

    def _shown_position(self, axis: int) -> float:
        if self._physics_ns != self.now_ns:
            return self._stage.peek_reading(self.now_ns - self._physics_ns, self._all_forces(), axis)
        return self._stage.reading(axis)

    def _position_at_drive(self, axis: int) -> float:
        """What the encoder of the drive sees, m of the axis."""
        position = self._shown_position(axis)
        if not self._mountings:
            return position
        mounting = self._mountings[axis]
        return mounting.direction * (position - mounting.offset * self.drives[axis].resolution)

    # what acts on it -------------------------------------------------------------------------------------------------

    def at(self, time_ns: int, action: Callable[[], None]) -> None:
        """Plan an action for that instant; those of one instant run in the order in which they were planned."""
        self._planned += 1
        heappush(self._agenda, (max(time_ns, self.now_ns), self._planned, action))
        self._deadline_ns = min(self._deadline_ns, self._agenda[0][0])

    def jam(self, axis: int, force: float) -> None:
        """From now on the axis is held by `force` (N) of additional dry friction; 0 frees it."""
        self._run_physics()
        self._jam[axis] = force
        self._update()

    def push(self, axis: int, force: float) -> None:
        """From now on a force (N) that no drive made acts on the axis."""
        self._run_physics()
        self._push[axis] = force
        self._update()

    def change_plant(self, axis: int, key: str, value: float) -> float:
        """From now on that quantity of the axis' truth (Truth.changed) is `value`. Returns what it was."""
        self._run_physics()
        truth, before = self._stage.truth.changed(axis, key, value)
        self._stage.change(truth)
        return float(before)

    def advance(self, now_ns: int) -> list[Frame]:
        """Let time pass to now_ns, through everything that falls due on the way; a time already past changes nothing.

        Returns what the drives send unasked (CANopen heartbeats and emergencies; nothing under the other layouts).
        Physics is integrated from event to event (a command, an expiry), because forces change only then.
        """
        while self._deadline_ns <= now_ns:
            self.now_ns = max(self.now_ns, self._deadline_ns)
            self._run_physics()
            for drive in self.drives:
                if drive.deadline_ns <= self.now_ns:
                    drive.trip(self.now_ns)
                if drive.opens_ns <= self.now_ns:
                    drive.open(self.now_ns)
            self.outputs.expire(self.now_ns)
            while self._agenda and self._agenda[0][0] <= self.now_ns:
                heappop(self._agenda)[2]()
            self._update()
        if now_ns > self.now_ns:
            self.now_ns = now_ns
            if now_ns - self._physics_ns >= _LONGEST_NS:
                self._run_physics()
        if not self._nodes:
            return self._from_sensors() if self.sensors else []
        sampling = [node.servo.axis for node in self._nodes if node.next_ns <= self.now_ns]
        if sampling:
            self._run_physics()
            self._note_sampling_of(sampling)
        frames = [f for node in self._nodes for f in self._lines.leaving(node.servo.axis, node.advance(self.now_ns))]
        if sampling:
            self._update()  # a drive may have entered operation
        return [*frames, *self._from_sensors()] if self.sensors else frames

    def _run_physics(self) -> None:
        """Integrate up to now, before anything that acts on the stage changes."""
        if self.now_ns > self._physics_ns:
            try:
                if self.dish is None:
                    self._stage.advance(self.now_ns - self._physics_ns, self._force)
                else:
                    self.dish.advance(self._stage, self._physics_ns, self.now_ns - self._physics_ns, self._force)
            except (ValueError, OverflowError):  # a sine or a rounding of what is no number any more
                raise diverged(self.now_ns) from None
            total = sum(self._stage.positions)
            if total - total != 0.0:
                raise diverged(self.now_ns)
            self._physics_ns = self.now_ns

    def _update(self) -> None:
        """Carry the drives' forces, brakes and deadlines over to physics."""
        drives = self.drives
        self._force = [force + push for force, push in zip(self.applied_force, self._push, strict=True)]
        deadline_ns = self._agenda[0][0] if self._agenda else NEVER_NS
        for drive in drives:
            if drive.deadline_ns < deadline_ns:
                deadline_ns = drive.deadline_ns
            if drive.opens_ns < deadline_ns:
                deadline_ns = drive.opens_ns
        if self.outputs.nodes:
            bits, off_ns = self.outputs.switched()
            deadline_ns = min(deadline_ns, off_ns)
            if self.dish is not None:
                self.dish.outputs(bits, self.now_ns)
        self._deadline_ns = deadline_ns
        clamp = [
            jam + (hold if drive.status & _BRAKE else 0.0)
            for jam, hold, drive in zip(self._jam, self._brake_force, drives, strict=True)
        ]
        if clamp != self._clamp:
            self._clamp = clamp
            self._stage.clamp(clamp)

    # the bus ---------------------------------------------------------------------------------------------------------

    def on_frame(self, frame: Frame) -> list[Frame]:
        """The drives' answers, in axis order, to a frame received at frame.timestamp_ns; none unless it concerns them.

        A frame stamped before `now_ns` (late delivery) counts as received now: the past cannot be changed.
        """
        if frame.can_id not in self.acceptance:
            return []  # a drive's own answer, heard by the others
        if self.outputs.nodes and self.outputs.tells(frame):
            return self._to_outputs(frame)
        answers = self._from_drives(frame)
        if self.outputs.senders and not segment_of(frame):
            answers = [*answers, *self._to_outputs(frame)]
        return [*answers, *self._sense(frame)] if self.sensors else answers

    def _to_outputs(self, frame: Frame) -> list[Frame]:
        due = self.advance(frame.timestamp_ns)
        self._run_physics()
        answers = self.outputs.hear(frame, self.now_ns)
        self._update()
        return [*due, *answers]

    def _sense(self, frame: Frame) -> list[Frame]:
        """The readings of the sensors that sample at this frame, as far as they are due."""
        heard = [] if segment_of(frame) else [sensor for sensor in self.sensors if sensor.hears(frame)]
        if not heard:
            return []
        due = self.advance(frame.timestamp_ns)
        self._run_physics()
        for sensor in heard:
            sensor.hear(frame, self)
        return [*due, *self._from_sensors()]

    def _from_sensors(self) -> list[Frame]:
        return [frame for sensor in self.sensors for frame in sensor.due(self.now_ns)]

    def _from_drives(self, frame: Frame) -> list[Frame]:
        if self._decode is None:
            return self._to_nodes(frame)
        command = self._decode(frame)
        if isinstance(command, Reject):
            self.rejected[command] += 1
            if command is Reject.INVALID_VALUE:  # it arrived intact and asks for the impossible: the host is broken
                return self._fail(self._lines.reached_by(frame), frame.timestamp_ns)
            return []
        due = self.advance(frame.timestamp_ns)
        self._run_physics()
        answers = self._obey(command, self._lines.reached_by(frame))
        return [*due, *answers] if due else answers

    def sender_of(self, answer: Frame) -> str:
        """Name of the axis whose drive, or of the sensor that, sent this answer."""
        return self._lines.senders[answer.can_id]

    def _fail(self, axes: range, now_ns: int) -> list[Frame]:
        due = self.advance(now_ns)
        self._run_physics()
        for axis in axes:
            self.drives[axis].fail()
        self._update()
        return due

    def _obey(self, command: Command, axes: range) -> list[Frame]:
        now_ns = self.now_ns
        if len(axes) == len(self.drives):
            self.sampled = self._stage.positions, self._stage.velocities
        else:
            self._note_sampling_of(axes)
        positions = self._stage.readings()
        if self._mountings:
            positions = [self._position_at_drive(axis) for axis in range(len(self.drives))]
        frames_of = self._frames_of
        sequence, forces, enable, reset = command
        answers: list[Frame] = []
        for axis in axes:
            drive = self.drives[axis]
            if drive.on_command(forces[axis], bool(enable >> axis & 1), reset, sequence, now_ns):
                sample = drive.sample(positions[axis], now_ns)
                answers += self._lines.leaving(axis, frames_of(sample))
                self.commands += axis == 0
        self._update()
        return answers

    def _to_nodes(self, frame: Frame) -> list[Frame]:
        answers = self.advance(frame.timestamp_ns)
        self._run_physics()
        heard = Frame(frame.can_id, frame.data, frame.flags & ~SEGMENT, self.now_ns)
        obeyed_ns, sampled_ns = self.drives[0].last_command_ns, [node.sampled_ns for node in self._nodes]
        axes = self._lines.reached_by(frame)
        for node in self._nodes:
            if node.servo.axis in axes:
                answers += self._lines.leaving(node.servo.axis, node.on_frame(heard))
        self.commands += self.drives[0].last_command_ns != obeyed_ns
        # Also at a SYNC whose torques were lost
        sampling = [
            node.servo.axis for node, before in zip(self._nodes, sampled_ns, strict=True) if node.sampled_ns != before
        ]
        if sampling:
            self._note_sampling_of(sampling)
        self._update()
        return answers

    def _feedback_alone(self, sample: Sample) -> list[Frame]:
        """Of layouts that carry the state of a drive beside its position."""
        assert self._protocol is not None
        return [self._protocol.encode_feedback(sample)]

    def _note_sampling_of(self, axes: Sequence[int]) -> None:
        """Of drives that sample each in its own time."""
        positions, velocities = list(self.sampled[0]), list(self.sampled[1])
        for axis in axes:
            positions[axis], velocities[axis] = self._stage.positions[axis], self._stage.velocities[axis]
        self.sampled = positions, velocities
