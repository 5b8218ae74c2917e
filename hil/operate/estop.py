"""`hil estop NAME`: stop a rig now, by its name alone (hil/live/stop_page.py).

hil/__main__.py calls `stop_rig` before anything else is loaded, so nothing here may import what takes time.
"""

import os
import sys
import time

from drivers.base.runtime_path import named_directory
from hil.live.stop_page import Page, Status, live_pages

OK, NOT_STOPPED, NOBODY, HUNG = 0, 1, 69, 70  # exit status; hil/cli/exit_status.py
LATCH_S = 0.5  # beyond any tick: who does not answer within it does not run


def stop_rig(name: str) -> int:
    """Press stop on every control process of that name; print what each recorded. Returns the exit status."""
    pages = live_pages(name)
    if not pages:
        named = f", in {named_directory()!a}, which the environment names: unset it to look everywhere"
        where = f"as user {os.geteuid()}{named if named_directory() else ''}"
        print(f"hil estop: no control process of the name {name!a} is running ({where})", file=sys.stderr)
        return NOBODY
    pressed = [page.press() for page in pages]  # all of them before the first answer is waited for
    return max(report(name, page, at, page.await_latch(at, LATCH_S)) for page, at in zip(pages, pressed, strict=True))


def report(name: str, page: Page, pressed_ns: int, status: Status) -> int:
    """Print what one control process made of the press; its exit status."""
    verdict, text = told(name, pressed_ns, status)
    print(text, file=sys.stderr if verdict == HUNG else sys.stdout)
    return verdict


def told(name: str, pressed_ns: int, status: Status) -> tuple[int, str]:
    """What one control process made of the press: its exit status, and in words."""
    who = f"{name} (pid {status.pid})"
    if status.latched_at >= pressed_ns:
        after_ms = (status.latched_at - pressed_ns) / 1e6
        text = f"{who}: {status.latched_state} in tick {status.latched_index}, {after_ms:.1f} ms after the press"
        return OK if status.latched_state == "ESTOP" else NOT_STOPPED, text
    last = "it has not begun"
    if status.alive_at:
        age_s = (time.monotonic_ns() - status.alive_at) / 1e9
        last = f"its last word was {status.state} in tick {status.index}, {age_s:.1f} s ago"
    if status.alive:
        fate = f"pressed, but the process does not run: {last}. It stops in its next tick"
    else:
        fate = f"the process ended while stop was pressed: {last}"
    return HUNG, f"{who}: {fate}. The drives' watchdogs end the torque meanwhile"


def estop(name: str) -> None:
    """Stop the rig NAME (the name, not the file). Exit status 0: ESTOP is latched; 69: no such control process; 70: it
    does not run, and the drives' watchdogs act.
    """
    sys.exit(stop_rig(name))
