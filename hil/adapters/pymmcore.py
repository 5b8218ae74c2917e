"""A rig as stages of Micro-Manager, for pymmcore-plus: its XY stage, its Z stage, every other axis as one more Z stage.

    core = UniMMCore()
    with hil.motion("microscope") as mover:
        load_stages(core, mover)
        core.setXYPosition(100.0, -50.0)
        core.waitForDevice(core.getXYStageDevice())

Micro-Manager counts in micrometres; a rotary axis counts in microradians. A device is busy from the goal's tick until
its axes are in position, by their encoders.
"""

from collections.abc import Sequence
from threading import Lock
from typing import Final

from hil.rig.extras import install_command
from hil.runs.mover import Move, Mover

try:
    from pymmcore_plus.core import FocusDirection
    from pymmcore_plus.experimental.unicore import StageDevice, UniMMCore, XYStageDevice
except ImportError as error:
    raise ImportError(f"hil.adapters.pymmcore needs pymmcore-plus: {install_command('micro-manager')}") from error

PER_M: Final = 1e6  # um


class _Axes:
    """What the stages of both kinds have in common. names: of their axes. turn: a core asks its devices from several
    threads, and a rig is moved from one at a time.
    """

    def __init__(self, mover: Mover, names: Sequence[str], turn: "Lock") -> None:
        unknown = [name for name in names if name not in mover.axes]
        if unknown:
            raise ValueError(f"no axis {unknown[0]!r}: the rig has {', '.join(mover.axes)}")
        self._mover, self._names, self._turn = mover, tuple(names), turn
        self._origin = dict.fromkeys(names, 0.0)
        self._move: Move | None = None

    def where(self) -> list[float]:
        """Encoder positions less the origin, um."""
        with self._turn:
            positions = dict(zip(self._mover.axes, self._mover.status().position, strict=True))
        return [(positions[name] - self._origin[name]) * PER_M for name in self._names]

    def go(self, *places: float) -> None:
        """To positions, um. Raises GoalRefusedError."""
        targets = {name: self._origin[name] + at / PER_M for name, at in zip(self._names, places, strict=True)}
        with self._turn:
            self._move = self._mover.move_to(speed=1.0, line=False, **targets)

    def go_by(self, *steps: float) -> None:
        """By steps, um, counted from the target in force."""
        ways = {name: step / PER_M for name, step in zip(self._names, steps, strict=True)}
        with self._turn:
            self._move = self._mover.move_by(speed=1.0, line=False, **ways)

    def halt(self) -> None:
        """Stop here; busy until the axes rest."""
        with self._turn:
            self._move = self._mover.halt()

    def busy(self) -> bool:
        """The axes are on their way, or not in position yet. Raises MotionError where the rig no longer holds."""
        with self._turn:
            move, self._move = self._move, None
            if move is None:
                return False
            self._mover.sleep(0.0)  # a tick: in virtual time nothing else lets it pass
            if not move.done:
                self._move = move
            return self._move is not None

    def zero(self, *names: str) -> None:
        """The positions of these axes count from here."""
        with self._turn:
            positions = dict(zip(self._mover.axes, self._mover.status().setpoint, strict=True))
        for name in names or self._names:
            self._origin[name] = positions[name]


class RigXYStage(XYStageDevice):
    """Two axes of a rig. Raises ValueError for axes that it lacks."""

    def __init__(self, mover: Mover, axes: tuple[str, str] = ("x", "y"), turn: "Lock | None" = None) -> None:
        """turn: that all stages of one rig share."""
        super().__init__()
        self._axes, self._names = _Axes(mover, axes, turn or Lock()), axes

    def set_position_um(self, x: float, y: float) -> None:
        """Send both axes there. Raises GoalRefusedError."""
        self._axes.go(x, y)
        self.core.events.XYStagePositionChanged.emit(self.get_label(), x, y)

    def set_relative_position_um(self, dx: float, dy: float) -> None:
        """By steps from the target in force, so that steps add up without error."""
        self._axes.go_by(dx, dy)

    def get_position_um(self) -> tuple[float, float]:
        """Of the encoders, less the origin."""
        x, y = self._axes.where()
        return x, y

    def busy(self) -> bool:
        """Until both are in position."""
        return self._axes.busy()

    def stop(self) -> None:
        """Stop all axes of the rig here, and hold."""
        self._axes.halt()

    def home(self) -> None:
        """To the origin; a rig has found its reference before it takes goals."""
        self.set_position_um(0.0, 0.0)

    def set_origin_x(self) -> None:
        """Count x from here."""
        self._axes.zero(self._names[0])

    def set_origin_y(self) -> None:
        """Count y from here."""
        self._axes.zero(self._names[1])


class RigStage(StageDevice):
    """One axis of a rig. Raises ValueError for one that it lacks."""

    def __init__(self, mover: Mover, axis: str = "z", turn: "Lock | None" = None) -> None:
        """turn: that all stages of one rig share."""
        super().__init__()
        self._axes = _Axes(mover, (axis,), turn or Lock())

    def set_position_um(self, val: float) -> None:
        """Send the axis there; of a rotary one, urad. Raises GoalRefusedError."""
        self._axes.go(val)
        self.core.events.stagePositionChanged.emit(self.get_label(), val)

    def set_relative_position_um(self, d: float) -> None:
        """By a step from the target in force."""
        self._axes.go_by(d)

    def get_position_um(self) -> float:
        """Of the encoder, less the origin."""
        return self._axes.where()[0]

    def get_focus_direction(self) -> FocusDirection:
        """Which way the objective is, a rig does not say."""
        return FocusDirection.Unknown

    def busy(self) -> bool:
        """Until it is in position."""
        return self._axes.busy()

    def stop(self) -> None:
        """Stop all axes of the rig here, and hold."""
        self._axes.halt()

    def home(self) -> None:
        """To the origin."""
        self.set_position_um(0.0)

    def set_origin(self) -> None:
        """Count from here."""
        self._axes.zero()


def load_stages(core: UniMMCore, mover: Mover, *, xy: tuple[str, str] = ("x", "y"), focus: str = "z") -> None:
    """Load a rig's axes into a core: XY (its XY stage), Z (its focus), and every other axis by its name.

    Raises ValueError where the rig lacks them.
    """
    turn = Lock()
    core.loadPyDevice("XY", RigXYStage(mover, xy, turn))
    core.loadPyDevice("Z", RigStage(mover, focus, turn))
    others = [name for name in mover.axes if name not in (*xy, focus)]
    for name in others:
        core.loadPyDevice(name, RigStage(mover, name, turn))
    for label in ("XY", "Z", *others):
        core.initializeDevice(label)
    core.setXYStageDevice("XY")
    core.setFocusDevice("Z")
