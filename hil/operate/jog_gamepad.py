"""`hil jog RIG --gamepad`: sticks are speeds while a shoulder button is held.

Each goal is good for VALID_S. A stick in its middle, a button let go, a device that is gone, a terminal that loses the
focus or a program that hangs: no more goals come, and the jog ends by itself.
"""

import select
import sys
from collections.abc import Callable
from typing import Final

from hil.cli.quantity import positions
from hil.cycle.goal import GoalRefusedError
from hil.operate.estop import stop_rig
from hil.operate.gamepad import (
    EAST,
    HAT_Y,
    LEFT_X,
    LEFT_Y,
    RIGHT_X,
    RIGHT_Y,
    SELECT,
    SHOULDER_LEFT,
    SHOULDER_RIGHT,
    SOUTH,
    START,
    Gamepad,
    GamepadGoneError,
)
from hil.operate.keys import Keys
from hil.runs.mover import Mover

STICKS: Final = ((LEFT_X, 1.0), (LEFT_Y, -1.0), (RIGHT_Y, -1.0), (RIGHT_X, 1.0))  # of the first axes; up is positive
SPEEDS: Final = tuple(digit * 10.0**power for power in range(-6, -1) for digit in (1.0, 2.0, 5.0))  # m/s at the end
FIRST: Final = 9  # 1 mm/s
ROTARY: Final = 10.0  # times, in rad/s
DEADMAN: Final = (SHOULDER_LEFT, SHOULDER_RIGHT)
VALID_S: Final = 0.15
POLL_S: Final = 0.05
FOCUS_ON, FOCUS_OFF = "\x1b[?1004h", "\x1b[?1004l"  # ask a terminal to tell
GAINED, LOST = "\x1b[I", "\x1b[O"


class PadJog:
    """What the gamepad does. said: why the last goal was refused. focused: the terminal has the keyboard."""

    def __init__(self, mover: Mover, pad: Gamepad, stop: Callable[[], object]) -> None:
        """stop: the emergency stop."""
        self._mover, self._pad, self._stop = mover, pad, stop
        self._size = FIRST
        self.said = ""
        self.focused = True

    @property
    def speed(self) -> float:
        """With a stick at its end, m/s; of a rotary axis ROTARY times, rad/s."""
        return SPEEDS[self._size]

    def turn(self, pressed: list[int], typed: str = "") -> bool:
        """What was pressed, then a goal where one is wanted. typed: at the terminal. False: leave."""
        gained, lost = typed.rfind(GAINED), typed.rfind(LOST)
        self.focused = self.focused if gained == lost else gained > lost
        for button in pressed:
            if button == EAST:
                self._stop()
            elif button == SOUTH:
                self._mover.halt()
            elif button in (HAT_Y, -HAT_Y):
                self._size = min(max(self._size + (1 if button < 0 else -1), 0), len(SPEEDS) - 1)
        if {SELECT, START} & set(pressed) or "q" in typed:
            return False
        if self.focused and SOUTH not in pressed and self._pad.holds(DEADMAN):
            self._jog()
        return True

    def _jog(self) -> None:
        speeds = {}
        for name, (stick, sign) in zip(self._mover.axes, STICKS, strict=False):
            part = sign * self._pad.stick(stick)
            if part:
                most = self._mover.most_speed(name)
                wanted = part * self.speed * (ROTARY if self._mover.kinds[name] == "rotary" else 1.0)
                speeds[name] = max(-most, min(wanted, most))
        self.said = ""
        try:
            if speeds:
                self._mover.jog(seconds=VALID_S, **speeds)
        except GoalRefusedError as refused:
            self.said = str(refused)

    def line(self) -> str:
        """Where the axes are, and the speed."""
        look = self._mover.status()
        places = "  ".join(positions(self._mover.kinds, look.position, "+"))
        lost = "" if self.focused else "this window lacks the focus"
        return f"{look.motion.name.lower():6} {places}  {self.speed * 1e3:g} mm/s  {self.said or lost}".rstrip()


def by_gamepad(mover: Mover, name: str, path: str | None) -> None:
    """Until select, start, q or Ctrl-C. path: of the device. Raises ValueError where it is gone, MotionError as the
    mover.
    """
    try:
        with Gamepad.open(path or None) as pad, Keys(sys.stdin.fileno()) as keys:
            print(
                "hold a shoulder button: left stick x y, right stick z theta; up and down of the cross: speed; "
                "A halts, B stops (as hil estop does), start leaves"
            )
            jog = PadJog(mover, pad, lambda: stop_rig(name))
            try:
                _jog(jog, pad, keys)
            finally:
                print(FOCUS_OFF)
    except GamepadGoneError as error:
        raise ValueError(str(error)) from None


def _jog(jog: PadJog, pad: Gamepad, keys: Keys) -> None:
    print(FOCUS_ON, end="")
    goes_on = True
    while goes_on:
        select.select([pad], [], [], POLL_S)
        goes_on = jog.turn(pad.read(), keys.within(0.0))
        print(f"\r{jog.line()}\x1b[K", end="", flush=True)
