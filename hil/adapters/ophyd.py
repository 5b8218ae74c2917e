"""A rig as devices of Bluesky, for ophyd-async: an axis is a movable, and the rig flies paths.

    mover = hil.motion("microscope")
    stage = RigStage(mover, name="stage")     # stage.x, stage.y, ...: Movable, Stoppable, Readable, Locatable
    RE(bps.mv(stage.x, 1e-3, stage.y, -5e-4))
    RE(fly(stage.flyer, PathInfo({"x": [0.0, 1e-3], "y": [0.0, 0.0]}, speed=0.01)))

Positions in m (rad), as everywhere in hil. A status is done once the axis is in position, by its encoder.
"""

import asyncio
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from functools import cached_property
from typing import Final, NamedTuple, TypeVar

from hil.live.goal_link import Look
from hil.rig.extras import install_command
from hil.runs.mover import LOOK_S, Move, Mover

try:
    from ophyd_async.core import (
        Device,
        FlyableLogic,
        MovableLogic,
        SignalR,
        SignalRW,
        SoftSignalBackend,
        StandardFlyable,
        StandardMovable,
        StandardReadable,
        StandardReadableFormat,
        TimeoutCalculator,
        soft_signal_rw,
    )
except ImportError as error:
    raise ImportError(f"hil.adapters.ophyd needs ophyd-async: {install_command('ophyd')}") from error

POLL_S: Final = 0.05  # between the readings of who subscribes
T = TypeVar("T")
UNITS: Final = {"linear": "m", "rotary": "rad"}


class _Shared:
    """One rig for all its devices: one thread does all that takes time, in order, so that the event loop goes on."""

    def __init__(self, mover: Mover) -> None:
        self.mover = mover
        self._thread = ThreadPoolExecutor(1, "rig")

    async def _do(self, work: Callable[[], T]) -> T:
        return await asyncio.get_running_loop().run_in_executor(self._thread, work)

    async def begin(self, targets: dict[str, float]) -> Move:
        """Raises GoalRefusedError."""
        return await self._do(lambda: self.mover.move_to(speed=1.0, line=False, **targets))

    async def fly(self, info: "PathInfo") -> Move:
        """Begin a path; raises as Mover.path."""
        return await self._do(
            lambda: self.mover.path(info.points, speed=info.speed, blend=info.blend, dwell_s=info.dwell_s)
        )

    async def halt(self) -> None:
        """Stop all axes here, and hold."""
        await self._do(self.mover.halt)

    async def look(self) -> Look:
        """The newest tick."""
        return await self._do(self.mover.status)

    async def until_done(self, move: Move) -> None:
        """Raises MotionError where it was cut short or the rig no longer holds."""
        while not await self._do(lambda: move.done):
            await self._do(lambda: self.mover.sleep(LOOK_S))


@dataclass
class _AxisLogic(MovableLogic[float]):
    """What ophyd-async asks of an axis."""

    setpoint: SignalRW[float]
    readback: SignalR[float]
    shared: _Shared
    axis: str

    async def stop(self) -> None:
        """Stop all axes of the rig here, and hold."""
        await self.shared.halt()

    async def check_move(self, new_position: float) -> None:
        """Raises ValueError beyond where goals may lead."""
        low, high = self.shared.mover.range_of(self.axis)
        if not low <= new_position <= high:
            raise ValueError(f"{self.axis} = {new_position:g}: from {low:.6g} to {high:.6g}")

    async def move(self, new_position: float, timeout: TimeoutCalculator) -> None:
        """Until the axis is in position. Raises TimeoutError, and then the move goes on."""
        await self.setpoint.set(new_position)
        move = await self.shared.begin({self.axis: new_position})
        await asyncio.wait_for(self.shared.until_done(move), timeout())


class RigAxis(StandardReadable, StandardMovable[float]):
    """One axis: set, stop, read, locate, subscribe."""

    def __init__(self, shared: _Shared, axis: str, name: str = "") -> None:
        units, place = UNITS[shared.mover.kinds[axis]], shared.mover.axes.index(axis)

        async def position() -> float:
            return (await shared.look()).position[place]

        backend = SoftSignalBackend(float, units=units, getter=position, poll_period=POLL_S)
        with self.add_children_as_readables(StandardReadableFormat.HINTED_SIGNAL):
            self.user_readback = SignalR(backend)
        self.user_setpoint = soft_signal_rw(float, shared.mover.status().setpoint[place], units=units)
        self._shared, self._axis = shared, axis
        super().__init__(name=name)

    @cached_property
    def movable_logic(self) -> _AxisLogic:
        """Of this axis."""
        return _AxisLogic(self.user_setpoint, self.user_readback, self._shared, self._axis)


class PathInfo(NamedTuple):
    """A path to fly, as Mover.path takes it. points: m (rad) by axis, all of one length, at least two. speed: m/s, at
    most and by default the least of the axes' limits. blend: how far corners may be cut, m. dwell_s: at each point.
    """

    points: Mapping[str, Sequence[float]]
    speed: float | None = None
    blend: float = 0.0
    dwell_s: float = 0.0


@dataclass
class _Flight:
    """A path on its way. move: once it has begun."""

    info: PathInfo
    move: Move | None = field(default=None)


class PathLogic(FlyableLogic[PathInfo, _Flight]):
    """Prepare: to the path's first point. Kick off: begin it. Complete: the axes rest in position at its end."""

    def __init__(self, shared: _Shared) -> None:
        self._shared = shared
        self._flying = False

    async def on_prepare(self, value: PathInfo) -> _Flight:
        """Go to the first point."""
        first = await self._shared.begin({axis: places[0] for axis, places in value.points.items()})
        await self._shared.until_done(first)
        return _Flight(value)

    async def on_kickoff(self, ctx: _Flight) -> _Flight:
        """Begin the path."""
        ctx.move = await self._shared.fly(ctx.info)
        self._flying = True
        return ctx

    async def on_complete(self, ctx: _Flight) -> None:
        """Raises MotionError where it was cut short."""
        assert ctx.move is not None  # the order of the three is ophyd-async's
        await self._shared.until_done(ctx.move)
        self._flying = False

    async def stop(self) -> None:
        """Stop a path that flies, here, and hold."""
        if self._flying:
            self._flying = False
            await self._shared.halt()


class RigStage(Device):
    """All axes of a rig as children of their names, and `flyer`. mover: from hil.motion, which the caller closes."""

    def __init__(self, mover: Mover, name: str = "") -> None:
        shared = _Shared(mover)
        for axis in mover.axes:
            setattr(self, axis, RigAxis(shared, axis))
        self.flyer = StandardFlyable()
        self.flyer.flyable_logic = PathLogic(shared)
        super().__init__(name=name)
