"""`hil jog RIG` with the keys of a terminal: a press is a step, a key held down a jog that ends when it is let go.

Terminals tell presses alone, and of a key held down the same press again and again. So a jog is good for VALID_S after
the last one: a key let go, a terminal that hangs or a connection that is lost end it.
"""

import math
import re
import sys
from collections.abc import Callable
from typing import Any, Final

from hil.cli.quantity import positions
from hil.cycle.goal import GoalRefusedError
from hil.live.goal_link import Look
from hil.operate.estop import stop_rig
from hil.operate.keys import Keys
from hil.runs.mover import Mover

# Of the first axes: the keys that lead to lower and to higher positions, and their names.
PAIRS: Final = (("\x1b[D", "\x1b[C"), ("\x1b[B", "\x1b[A"), ("\x1b[6~", "\x1b[5~"), ("[", "]"))
NAMES: Final = ("left right", "down up", "PgDn PgUp", "[ ]")
STEPS: Final = tuple(
    digit * 10.0**power for power in range(-7, -2) for digit in (1.0, 2.0, 5.0)
)  # m; ROTARY times in rad
FIRST: Final = 6  # 10 um
ROTARY: Final = 10.0
RATE: Final = 20.0  # steps a second while a key is held
VALID_S: Final = 0.15
HELD_S: Final = 0.1  # the same key again within this is held down
POLL_S: Final = 0.05
FINER, COARSER, HALT, STOP, LEAVE = "-", "+", " ", "e", "q"
_KEY: Final = re.compile(r"\x1b\[(?:[A-D]|[56]~)|.", re.DOTALL)


class KeyJog:
    """What each key does. step: of a press, m (rotary axes: ROTARY times, rad). said: why the last goal was refused."""

    def __init__(self, mover: Mover, stop: Callable[[], object]) -> None:
        """stop: the emergency stop."""
        self._mover, self._stop = mover, stop
        self._moves = {
            key: (axis, sign) for axis, pair in enumerate(PAIRS) for key, sign in zip(pair, (-1, 1), strict=True)
        }
        self._size = FIRST
        self._last, self._last_s = "", -math.inf
        self.said = ""

    @property
    def step(self) -> float:
        """Of a press."""
        return STEPS[self._size]

    def press(self, text: str, now_s: float) -> bool:
        """Keys as a terminal sends them; one of them many times is one. False: leave."""
        for key in dict.fromkeys(_KEY.findall(text)):
            if key == LEAVE:
                return False
            self._one(key, held=key == self._last and now_s - self._last_s <= HELD_S)
            self._last, self._last_s = key, now_s
        return True

    def _one(self, key: str, *, held: bool) -> None:
        axis, sign = self._moves.get(key, (-1, 0))
        if key == STOP:
            self._stop()
        elif key == HALT:
            self._mover.halt()
        elif key in (FINER, COARSER):
            self._size = min(max(self._size + (1 if key == COARSER else -1), 0), len(STEPS) - 1)
        elif 0 <= axis < len(self._mover.axes):
            self._move(self._mover.axes[axis], sign, held=held)

    def _move(self, name: str, sign: int, *, held: bool) -> None:
        way = sign * self.step * (ROTARY if self._mover.kinds[name] == "rotary" else 1.0)
        self.said = ""
        try:
            if held:
                most = self._mover.most_speed(name)
                self._mover.jog(seconds=VALID_S, **{name: math.copysign(min(RATE * abs(way), most), way)})
            else:
                step: dict[str, Any] = {name: way}
                self._mover.move_by(**step)
        except GoalRefusedError as refused:
            self.said = str(refused)

    def line(self, look: Look) -> str:
        """Where the axes are, and the step."""
        places = "  ".join(positions(self._mover.kinds, look.position, "+"))
        return f"{look.motion.name.lower():6} {places}  step {self.step * 1e6:g} um  {self.said}".rstrip()


def by_keys(mover: Mover, name: str) -> None:
    """Until q or Ctrl-C. Raises ValueError where standard input is no terminal, MotionError as the mover."""
    if not sys.stdin.isatty():
        raise ValueError("without AXIS=SPEED it takes keys, and needs a terminal")
    pairs = ", ".join(f"{axis} {keys}" for axis, keys in zip(mover.axes, NAMES, strict=False))
    print(f"{pairs}; hold a key to go on; - + step size, space halts, {STOP} stops (as hil estop does), {LEAVE} leaves")
    jog = KeyJog(mover, lambda: stop_rig(name))
    with Keys(sys.stdin.fileno()) as keys:
        while jog.press(keys.within(POLL_S), mover.now_ns() * 1e-9):
            print(f"\r{jog.line(mover.status())}\x1b[K", end="", flush=True)
    print()
