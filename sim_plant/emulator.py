"""The emulated stage on a bus: physics and drives as one function of received frames and time; no I/O, no clock.

At the reception of a command frame all drives sample their encoders, answer, and from that instant apply the new
forces.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from drivers.config import BusConfig
from drivers.frame import Frame
from drivers.protocols import device_protocol
from drivers.protocols.base import Command, DriveStatus, Reject
from sim_plant.config import PlantConfig
from sim_plant.drive import NEVER_NS, ServoDrive
from sim_plant.stage import Stage, Truth, per_axis_array

Array = NDArray[np.float64]

_BRAKE = int(DriveStatus.BRAKE)
_LONGEST_NS = 100_000_000  # of one integration: what `position` has to make up for stays bounded


class EmulatedStage:
    """Stage and drives behind one of the frame layouts.

    plant: the truth. bus: layout and identifiers. axis_names: in bus order. rated_force: N per axis, the drives' data
    sheet. base_dir: where the rig file is (for a relative dbc path). start_ns: the clock's first value.

    rejected: received frames that carried no command, by reason. sampled_position, sampled_velocity: truth (m, m/s,
    (n_axes,)) at the latest sampling, before the encoder. Raises ValueError for a plant or bus that does not fit.
    """

    def __init__(
        self,
        plant: PlantConfig,
        bus: BusConfig,
        axis_names: Sequence[str],
        rated_force: Sequence[float],
        base_dir: Path,
        start_ns: int = 0,
    ) -> None:
        n_axes = len(axis_names)
        self.axis_names = list(axis_names)
        self.now_ns = start_ns
        self._physics_ns = start_ns
        self.rejected: dict[Reject, int] = dict.fromkeys(Reject, 0)
        self._protocol = device_protocol(bus, n_axes, rated_force, base_dir)
        self._stage = Stage(
            Truth.from_config(plant, n_axes, axis_names),
            per_axis_array("plant.initial_position", plant.initial_position, n_axes),
        )
        resolution = per_axis_array("plant.encoder_resolution", plant.encoder_resolution, n_axes).tolist()
        brake = per_axis_array("plant.brake", plant.brake, n_axes).astype(bool).tolist()
        modulus = int(getattr(self._protocol, "sequence_modulus", 0))
        watchdog_ns = round(plant.watchdog_s * 1e9)
        self.drives = [
            ServoDrive(axis, rated_force[axis], resolution[axis], watchdog_ns, brake[axis], modulus)
            for axis in range(n_axes)
        ]
        self._brake_force = per_axis_array("plant.brake_force", plant.brake_force, n_axes).tolist()
        self._jam = [0.0] * n_axes
        self._force = [0.0] * n_axes
        self.sampled_position = self._stage.position.copy()
        self.sampled_velocity = self._stage.velocity.copy()
        self._senders: dict[int, str] = {}
        self._clamp: list[float] = []
        self._deadline_ns = NEVER_NS
        self._update()

    @property
    def position(self) -> Array:
        """True position now, m, (n_axes,). Looking changes nothing, not even the rounding of what follows."""
        return self._stage.peek(self.now_ns - self._physics_ns, self._force)[0]

    @property
    def velocity(self) -> Array:
        """True velocity now, m/s, (n_axes,)."""
        return self._stage.peek(self.now_ns - self._physics_ns, self._force)[1]

    @property
    def pierced(self) -> Array:
        """1.0 where the axis' cell is pierced, (n_axes,)."""
        return self._stage.peek(self.now_ns - self._physics_ns, self._force)[2]

    @property
    def applied_force(self) -> list[float]:
        """Force each drive applies now, N."""
        return self._force

    @property
    def deadline_ns(self) -> int:
        """When the next drive watchdog expires; NEVER_NS where none is armed."""
        return self._deadline_ns

    def sender_of(self, answer: Frame) -> str:
        """Name of the axis whose drive sent this answer."""
        return self._senders[answer.can_id]

    def jam(self, axis: int, force: float) -> None:
        """From now on the axis is held by `force` (N) of additional dry friction; 0 frees it."""
        self._run_physics()
        self._jam[axis] = force
        self._update()

    def advance(self, now_ns: int) -> None:
        """Let time pass to now_ns, through every watchdog that expires on the way; a time already past changes nothing.

        Physics is integrated from event to event (a command, an expiry), because forces change only then.
        """
        while self._deadline_ns <= now_ns:
            self.now_ns = self._deadline_ns
            self._run_physics()
            for drive in self.drives:
                if drive.deadline_ns <= self.now_ns:
                    drive.trip(self.now_ns)
            self._update()
        if now_ns > self.now_ns:
            self.now_ns = now_ns
            if now_ns - self._physics_ns >= _LONGEST_NS:
                self._run_physics()

    def on_frame(self, frame: Frame) -> list[Frame]:
        """The drives' answers, in axis order, to a frame received at frame.timestamp_ns; none unless it commands.

        A frame stamped before `now_ns` (late delivery) counts as received now: the past cannot be changed.
        """
        command = self._protocol.decode_command(frame)
        if isinstance(command, Reject):
            self.rejected[command] += 1
            if command is Reject.INVALID_VALUE:  # it arrived intact and asks for the impossible: the host is broken
                self._fail_all(frame.timestamp_ns)
            return []
        self.advance(frame.timestamp_ns)
        self._run_physics()
        return self._answer(command)

    def _fail_all(self, now_ns: int) -> None:
        self.advance(now_ns)
        self._run_physics()
        for drive in self.drives:
            drive.fail()
        self._update()

    def _answer(self, command: Command) -> list[Frame]:
        now_ns = self.now_ns
        self.sampled_position[:] = self._stage.position
        self.sampled_velocity[:] = self._stage.velocity
        positions = self._stage.position.tolist()
        sequence, forces, enable, reset = command
        answers = []
        for drive, position, force in zip(self.drives, positions, forces, strict=True):
            enabled = bool(enable >> drive.axis & 1)
            if drive.on_command(force, enabled, reset, sequence, now_ns):
                answer = self._protocol.encode_feedback(drive.sample(position, now_ns))
                self._senders[answer.can_id] = self.axis_names[drive.axis]
                answers.append(answer)
        self._update()
        return answers

    def _run_physics(self) -> None:
        """Integrate up to now, before anything that acts on the stage changes."""
        if self.now_ns > self._physics_ns:
            self._stage.advance(self.now_ns - self._physics_ns, self._force)
            self._physics_ns = self.now_ns

    def _update(self) -> None:
        """Carry the drives' forces, brakes and deadlines over to physics."""
        self._force = [drive.force for drive in self.drives]
        self._deadline_ns = min(drive.deadline_ns for drive in self.drives)
        clamp = [
            jam + (hold if drive.status & _BRAKE else 0.0)
            for jam, hold, drive in zip(self._jam, self._brake_force, self.drives, strict=True)
        ]
        if clamp != self._clamp:
            self._clamp = clamp
            self._stage.clamp(clamp)
