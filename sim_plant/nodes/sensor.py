"""An emulated sensor: samples at the frame its drives sample at, and sends one reading.

Written from the table of bytes in docs/sensors.md, apart from the host's side (drivers/sensors): what one gets wrong
shows against the other.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Protocol

from drivers.frame import Frame
from drivers.sensors.config import SensorConfig
from sim_plant.config import OF_DISH, EmulatedSensorConfig
from sim_plant.nodes.sensor_frames import Carrier, Sampled
from sim_plant.physics.dish import Dish
from sim_plant.physics.membrane import Membrane
from sim_plant.physics.noise import READING, Stream
from sim_plant.physics.truth import Truth

NEVER_NS = 2**62

FAILING = tuple(measured for measured in OF_DISH if measured != "pressure")  # with the anomaly of a cell
Tap = Callable[[Sampled], Sampled | None]


class Stage(Protocol):
    """What a sensor can look at of the emulated stage; by axis, at the instant of the sample, SI."""

    axis_names: list[str]
    now_ns: int
    dish: Dish | None

    @property
    def applied_force(self) -> list[float]:
        """N of each drive."""

    @property
    def tips(self) -> tuple[list[float], list[float], list[float]]:
        """Positions (m), velocities (m/s), and 1.0 where the cell is pierced."""

    @property
    def truth(self) -> Truth:
        """What the stage is like."""


class SensorNode:
    """One sensor. name, config: as in [sensors]. place: its place there. entry: of [[plant.sensors]]; None: it measures
    nothing but noise. carrier: what its samples go out in. trigger: mask and identifier of the host's frame at whose
    end it samples.

    taps: what every sample goes through before it is sent; None from one of them: nothing is sent.
    """

    def __init__(
        self,
        name: str,
        config: SensorConfig,
        place: int,
        entry: EmulatedSensorConfig | None,
        carrier: Carrier,
        trigger: tuple[int, int],
        seed: int,
    ) -> None:
        self.name, self.config, self.can_id = name, config, config.can_id
        self.can_ids: tuple[int, ...] = (config.can_id,)
        self.carrier = carrier
        self.taps: list[Tap] = []
        self._mask, self._trigger = trigger
        self._entry = entry
        own_noise = config.noise if entry is None or entry.noise is None else entry.noise
        self._noise = own_noise
        self._stream = Stream(seed, place, READING)
        self.delay_ns = 0 if entry is None else round(entry.delay * 1e9)
        self._frame_ns = 0 if entry is None else round(entry.frame_s * 1e9)
        self._filter = _Filter(entry)
        self._next_ns = 0  # of the next frame; 0: in every tick
        self._frozen: Sampled | None = None
        self._count = 0
        self._waiting: list[tuple[int, Frame]] = []

    @property
    def next_ns(self) -> int:
        """When it has something to send; NEVER_NS where nothing waits."""
        return self._waiting[0][0] if self._waiting else NEVER_NS

    def hears(self, frame: Frame) -> bool:
        """Whether it samples at this frame."""
        return frame.can_id & self._mask == self._trigger

    def hear(self, frame: Frame, stage: Stage) -> None:
        """A frame that it hears: measure now, and send in `delay_ns`."""
        shown = self._sampled(stage)
        if shown is not None:
            self._waiting.append((stage.now_ns + self.delay_ns, self.carrier.frame(shown)))

    def _sampled(self, stage: Stage) -> Sampled | None:
        """What it shows now; None: nothing."""
        now_ns, carrier = stage.now_ns, self.carrier
        if self._frame_ns and not self._exposes(now_ns):
            return None
        value = self._filter.passed(self._measured(stage), now_ns)
        if self._noise:
            value += self._noise * float(self._stream.at(self._count))
        counts = max(carrier.least, min(carrier.most, round(value / carrier.resolution)))
        shown = self._failing(Sampled(counts, now_ns // 1000, self._count), stage)
        self._count += 1
        for tap in self.taps:
            if shown is not None:
                shown = tap(shown)
        return shown

    def due(self, now_ns: int) -> list[Frame]:
        """The frames whose time has come."""
        found = [frame for due_ns, frame in self._waiting if due_ns <= now_ns]
        del self._waiting[: len(found)]
        return found

    def _exposes(self, now_ns: int) -> bool:
        """Whether a frame of the camera is due; its frames stay on one grid, whatever the ticks."""
        if now_ns < self._next_ns:
            return False
        self._next_ns = (now_ns // self._frame_ns + 1) * self._frame_ns
        return True

    def _failing(self, shown: Sampled, stage: Stage) -> Sampled | None:
        """What it sends, while a cell's anomaly is that it fails."""
        if stage.dish is None or self._entry is None or self._entry.measures not in FAILING:
            return shown
        failure = stage.dish.failure(self._entry.measures != "tip_force")
        if failure == "silent":
            return None
        if failure != "stuck":
            self._frozen = shown
            return shown
        return shown if self._frozen is None else replace(shown, counts=self._frozen.counts)

    def _measured(self, stage: Stage) -> float:
        entry = self._entry
        if entry is None:
            return 0.0
        axis = stage.axis_names.index(entry.axis)
        if entry.measures == "applied_force":
            true = stage.applied_force[axis]
        elif entry.measures in OF_DISH:
            true = self._of_dish(stage, entry, axis)
        else:
            positions, velocities, pierced = stage.tips
            true = positions[axis]
            if entry.measures == "cell_force":
                true = cell_force(stage.truth, axis, true, velocities[axis], pierced[axis])
        return entry.offset + entry.gain * self._filter.faded(true, stage.now_ns)

    def _of_dish(self, stage: Stage, entry: EmulatedSensorConfig, axis: int) -> float:
        dish = stage.dish
        if dish is None:
            return 0.0
        if entry.measures == "tip_force":
            if not entry.tool_mass:
                return dish.force
            acceleration = self._filter.slope(stage.tips[1][axis], stage.now_ns)
            return dish.force + dish.direction * entry.tool_mass * acceleration
        if entry.measures == "pressure":
            return dish.pressure
        seen = {"cell_shift": dish.side, "bolus": dish.bolus, "tip_error": dish.tip_error, "dimple": dish.dimple}
        return seen[entry.measures]


class _Filter:
    """What lies between a quantity and its reading. Called once a sample, at growing instants."""

    def __init__(self, entry: EmulatedSensorConfig | None) -> None:
        self._lag, self._decay = (0.0, 0.0) if entry is None else (entry.lag, entry.decay)
        self._level: float | None = None  # behind the sensor's lag
        self._last: tuple[float, float] | None = None  # what was measured, and what has not faded of it
        self._speed: tuple[float, int] | None = None  # of the tip, and when
        self._lagged_ns = self._faded_ns = 0

    def passed(self, value: float, now_ns: int) -> float:
        """Behind the lag."""
        if self._lag and self._level is not None:
            passed = (now_ns - self._lagged_ns) * 1e-9
            value = self._level + (value - self._level) * (passed / (self._lag + passed))  # backward Euler
        self._level, self._lagged_ns = value, now_ns
        return value

    def faded(self, value: float, now_ns: int) -> float:
        """What a sensor shows that cannot hold a constant reading: a high pass of first order."""
        if not self._decay:
            return value
        was, left = self._last or (0.0, 0.0)
        left = (left + value - was) * (self._decay / (self._decay + (now_ns - self._faded_ns) * 1e-9))
        self._last, self._faded_ns = (value, left), now_ns
        return left

    def slope(self, speed: float, now_ns: int) -> float:
        """Mean acceleration since the last sample, m/s^2; 0 at the first."""
        last, self._speed = self._speed, (speed, now_ns)
        return 0.0 if last is None or now_ns <= last[1] else (speed - last[0]) / ((now_ns - last[1]) * 1e-9)


def cell_force(truth: Truth, axis: int, position: float, velocity: float, pierced: float) -> float:
    """Force of the axis' cell on its tip, N; positive while the tip presses on it."""
    direction = float(truth.cell_direction[axis])
    cell = Membrane(
        float(truth.cell_surface[axis]),
        direction,
        float(truth.cell_stiffness[axis]),
        float(truth.puncture_depth[axis]),
        float(truth.cell_drag[axis]),
    )
    return direction * float(cell.resistance(position, velocity, pierced))


def tapped(nodes: Sequence[SensorNode], tap_of: Callable[[SensorNode], Tap]) -> Callable[[], None]:
    """Put a tap of its own on each node; returns how to take them off."""
    taps = [(node, tap_of(node)) for node in nodes]
    for node, tap in taps:
        node.taps.append(tap)

    def undo() -> None:
        for node, tap in taps:
            node.taps.remove(tap)

    return undo


def silent(node: SensorNode) -> Tap:
    """It sends nothing."""
    return lambda shown: None


def stuck(node: SensorNode) -> Tap:
    """It goes on sending the next value."""
    held: list[int] = []

    def tap(shown: Sampled) -> Sampled:
        held[:] = held or [shown.counts]
        return replace(shown, counts=held[0])

    return tap


def showing(value: float) -> Callable[[SensorNode], Tap]:
    """It shows `value`, in its unit."""
    return lambda node: lambda shown: replace(shown, counts=round(value / node.carrier.resolution))


def renumbered(offset: int) -> Callable[[SensorNode], Tap]:
    """Its sequence numbers are off by so much."""
    return lambda node: lambda shown: replace(shown, sequence=shown.sequence + offset)


def repeating(node: SensorNode) -> Tap:
    """All its frames have the sequence number of the next."""
    held: list[int] = []

    def tap(shown: Sampled) -> Sampled:
        held[:] = held or [shown.sequence]
        return replace(shown, sequence=held[0])

    return tap


def invalid(node: SensorNode) -> Tap:
    """It says that its readings are not valid."""
    return lambda shown: replace(shown, status=1)
