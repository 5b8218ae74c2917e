"""Pacing by absolute deadlines on CLOCK_MONOTONIC.

Slot k of a run starts at epoch + k * period; a tick's index is its slot's number, so an index never lies about time.

Rules:
- A tick starts only out of a sleep (or, woken ahead, out of reading the clock), and at most KEEP_WITHIN of a period
  after its deadline. A slot that cannot be kept is skipped and counted; nothing is ever run in a burst to catch up. Two
  command frames closer than half a period would make the drives sample while the answers to the first one are still on
  the bus.
- The deadline is computed from the slot's number, never from when the last tick ended: lateness does not add up.
- The loop is woken before the deadline by what waking usually takes here, and reads the clock for the rest. One tick in
  ten starts late by more than a look at the clock, instead of every one. None starts early.
- Deadlines lie half a period off the multiples of the period on CLOCK_MONOTONIC. The kernel's own tick comes on
  multiples of its period (4 ms at 250 Hz) and brings softirqs, 16 to 40 us. Where it fell into the loop's ticks, it
  made three of four of their slowest hundredth.
"""

import ctypes
import errno
import os
import time
from collections.abc import Callable
from typing import Final

from drivers.native import path as native

KEEP_WITHIN = 0.5  # of a period: a slot is kept when its tick starts this soon after its deadline
WOKEN_IN_TIME: Final = 9  # wakes for each one that comes later than it was allowed for
AHEAD_STEP_NS: Final = 20  # 10 us more are followed within sixty late wakes, 10 us less within five hundred timely ones
AHEAD_WITHIN = 0.125  # of a period: a tick that leaves this much of it still ends in a sleep
MAX_RESLEEPS: Final = 3  # then the tick runs, however late: the stop flag and the watchdog live on ticks


class Pacer:
    """Slots of `period_ns` from `start()` on. The attributes describe the slot that `wait()` returned in.

    most_ahead_ns: by how much to be woken before the deadline at the most, within AHEAD_WITHIN; 0: never.

    index: slot number, 0-based. scheduled_ns: its deadline. now_ns: when the wait ended. skipped: slots lost just
    before this one. overrun: those of them lost while the tick before was still running; the others are late wakes.
    sleeps: made since start. ahead_ns: how long before its deadline the next slot's sleep is to end.
    now, sleep_until: the clock and the sleep, ns; tests put their own.
    """

    def __init__(
        self,
        period_ns: int,
        now: Callable[[], int] = time.monotonic_ns,
        sleep_until: Callable[[int], None] | None = None,
        most_ahead_ns: int = 0,
    ) -> None:
        if period_ns <= 0:
            raise ValueError(f"period_ns = {period_ns}: must be positive")
        self.period_ns = period_ns
        self.keep_ns = int(period_ns * KEEP_WITHIN)
        self.index = -1
        self.scheduled_ns = 0
        self.now_ns = 0
        self.skipped = 0
        self.overrun = 0
        self.sleeps = 0
        self.ahead_ns = 0
        self._most_ahead_ns = min(most_ahead_ns, int(period_ns * AHEAD_WITHIN))
        self._waking_ns = 0  # what the last wake took
        self._now = now
        self._sleep_until = sleep_until or sleeper()

    def start(self) -> None:
        """Let slot 0 begin within one period from now, at the deadline that lies half a period off a multiple of it."""
        self.index = -1
        now = self._now()
        self.scheduled_ns = now - (now - self.period_ns // 2) % self.period_ns
        self.skipped = self.sleeps = 0

    def wait(self) -> None:
        """Sleep to the start of the next slot that can still be kept; sets all attributes."""
        if self._most_ahead_ns:
            self._look_ahead()
        period, ahead = self.period_ns, self.ahead_ns
        deadline = self.scheduled_ns + period
        # The tick before may have run into this slot; the next one starts at the first deadline still ahead.
        skipped = self.overrun = max(0, -((deadline - self._now()) // period))
        for _ in range(MAX_RESLEEPS):
            slot = deadline + skipped * period
            self._sleep_until(slot - ahead)
            now = woken = self._now()
            while now < slot:
                now = self._now()
            self.sleeps += 1
            late = now - slot
            if late <= self.keep_ns:
                break
            skipped += late // period + 1
        else:
            skipped -= 1  # the slot `now` lies in
        self.index += 1 + skipped
        self.scheduled_ns = deadline + skipped * period
        self.now_ns = now
        self.skipped = skipped
        self._waking_ns = woken - slot + ahead

    def _look_ahead(self) -> None:
        """Follow the quantile of what waking takes: as many steps up at a late wake as there are timely ones to one."""
        steps = WOKEN_IN_TIME if self._waking_ns > self.ahead_ns else -1
        self.ahead_ns = min(max(0, self.ahead_ns + steps * AHEAD_STEP_NS), self._most_ahead_ns)


_CLOCK_MONOTONIC: Final = 1


_TIMER_ABSTIME: Final = 1


_SECOND_NS: Final = 1_000_000_000


_INTERRUPTED: Final = errno.EINTR


def run_signal_handlers() -> None:
    """Run the handlers of the signals that have come; raises what they raise.

    The interpreter does so between its own steps, of which the loop takes none where it is compiled.
    """
    ctypes.pythonapi.PyErr_CheckSignals()


def sleeper(*, alone: bool = False) -> Callable[[int], None]:
    """A function that sleeps until an instant of CLOCK_MONOTONIC, ns.

    alone: this process has no other thread, so the interpreter's lock is kept while asleep: taking it again would only
    lie between the wake and the tick. Signals end the sleep all the same.
    """
    if native:
        native_sleep: Callable[[int], None] = native.sleep_alone if alone else native.sleep_until
        return native_sleep
    call = (ctypes.PyDLL if alone else ctypes.CDLL)(None).clock_nanosleep
    call.restype = ctypes.c_int  # no argtypes: plain ints are passed as C ints, which is quicker than converters
    until = (ctypes.c_long * 2)()  # struct timespec
    address = ctypes.byref(until)

    def sleep_until(deadline_ns: int) -> None:
        until[0], until[1] = deadline_ns // _SECOND_NS, deadline_ns % _SECOND_NS
        while result := call(_CLOCK_MONOTONIC, _TIMER_ABSTIME, address, None):
            if result != _INTERRUPTED:
                raise OSError(result, f"clock_nanosleep: {os.strerror(result)}")
            run_signal_handlers()

    return sleep_until
