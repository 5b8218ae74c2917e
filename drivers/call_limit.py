"""A limit in time for calls of what users bring, at next to no cost: a plug-in that does not return is given up."""

import atexit
import os
import signal
import threading
from types import FrameType

CALL_LIMIT_S = 5.0  # a call that lasts as long never ends, or might as well; it is given up before twice that


class TooLongError(BaseException):
    """Raised in the midst of a plug-in's call; no Exception, so that the plug-in does not catch it by accident."""


FAILED = (Exception, SystemExit, TooLongError)  # what a plug-in's call may end with beside an answer


class Watch:
    """Ends a call that lasts too long, by a timer that looks every CALL_LIMIT_S whether the same call still runs.

    The calls themselves only count: no system call, no clock. A timer that finds no more calls stops itself.
    """

    def __init__(self) -> None:
        self.calls = self._seen = 0
        self.within = self.armed = False

    def begin(self) -> None:
        """A call begins."""
        if not self.armed:
            self._arm()
        self.calls += 1
        self.within = True

    def _arm(self) -> None:
        """Look from now on. Signals reach the main thread alone, and somebody else's timer is left alone."""
        if threading.current_thread() is not threading.main_thread():
            return
        self.armed = True
        if signal.getsignal(signal.SIGALRM) in (signal.SIG_DFL, None):
            signal.signal(signal.SIGALRM, self._look)
        if signal.getsignal(signal.SIGALRM) == self._look:
            signal.setitimer(signal.ITIMER_REAL, CALL_LIMIT_S, CALL_LIMIT_S)

    def disarm(self) -> None:
        """Another process has no such timer."""
        self.armed = self.within = False

    def _look(self, number: int, frame: FrameType | None) -> None:
        same, self._seen = self.calls == self._seen, self.calls
        if same and self.within:
            raise TooLongError(f"no answer within {CALL_LIMIT_S:g} s")
        if same:
            signal.setitimer(signal.ITIMER_REAL, 0.0)
            self.armed = False

    def rest(self) -> None:
        """No more timer: a process that is ending has no handler for it any more."""
        if self.armed and signal.getsignal(signal.SIGALRM) == self._look:
            signal.setitimer(signal.ITIMER_REAL, 0.0)


watch = Watch()
atexit.register(watch.rest)
os.register_at_fork(after_in_child=watch.disarm)
