"""A limit in time for calls of what users bring, at next to no cost: a plug-in that does not return is given up."""

import atexit
import ctypes
import os
import signal
import threading
from threading import get_ident
from types import FrameType

CALL_LIMIT_S = 5.0  # a call that lasts as long never ends, or might as well; it is given up before twice that


class TooLongError(BaseException):
    """Raised in the midst of a plug-in's call; no Exception, so that the plug-in does not catch it by accident."""

    def __init__(self) -> None:
        super().__init__(f"no answer within {CALL_LIMIT_S:g} s")


FAILED = (Exception, SystemExit, TooLongError)  # what a plug-in's call may end with beside an answer


class Watch:
    """Ends a call that lasts too long, by a timer that looks every CALL_LIMIT_S whether the same call still runs.

    The calls themselves only count: no system call, no clock. A timer that finds no more calls stops itself. Each
    thread has its own calls: those of the main thread are looked after by a signal, which reaches no other; those of
    the others by a thread.
    """

    def __init__(self) -> None:
        self.calls = self._seen = 0
        self.within = self.armed = False
        self._main = threading.main_thread().ident
        self._others = _OtherThreads()

    def begin(self) -> None:
        """A call begins."""
        if get_ident() != self._main:
            self._others.begin()
            return
        if not self.armed:
            self._arm()
        self.calls += 1
        self.within = True

    def renew(self) -> None:
        """One of the calls in a row has ended, and the next one begins, with the whole time again."""
        if get_ident() != self._main:
            self._others.begin()
        else:
            self.calls += 1

    def end(self) -> None:
        """It has ended, with an answer or without one."""
        if get_ident() != self._main:
            self._others.end()
        else:
            self.within = False

    def _arm(self) -> None:
        """Look from now on. Somebody else's timer is left alone."""
        self.armed = True
        if signal.getsignal(signal.SIGALRM) in (signal.SIG_DFL, None):
            signal.signal(signal.SIGALRM, self._look)
        if signal.getsignal(signal.SIGALRM) == self._look:
            signal.setitimer(signal.ITIMER_REAL, CALL_LIMIT_S, CALL_LIMIT_S)

    def disarm(self) -> None:
        """Another process has no such timer, and one thread: the one that made it."""
        self.armed = self.within = False
        self._main = threading.main_thread().ident
        self._others = _OtherThreads()

    def _look(self, number: int, frame: FrameType | None) -> None:
        same, self._seen = self.calls == self._seen, self.calls
        if same and self.within:
            raise TooLongError
        if same:
            signal.setitimer(signal.ITIMER_REAL, 0.0)
            self.armed = False

    def rest(self) -> None:
        """No more timer: a process that is ending has no handler for it any more."""
        if self.armed and signal.getsignal(signal.SIGALRM) == self._look:
            signal.setitimer(signal.ITIMER_REAL, 0.0)


class _OtherThreads:
    """The same for every thread but the main one."""

    def __init__(self) -> None:
        self._running: dict[int, object] = {}  # by thread: a token of its call
        self._lock = threading.Lock()
        self._looks = False

    def begin(self) -> None:
        self._running[get_ident()] = object()
        with self._lock:
            if not self._looks:
                self._looks = True
                threading.Thread(target=self._look, name="hil-call-limit", daemon=True).start()

    def end(self) -> None:
        try:
            with self._lock:  # from here on nothing more is raised for this call
                self._running.pop(get_ident(), None)
        except TooLongError:  # on its way when the answer came
            self._running.pop(get_ident(), None)

    def _look(self) -> None:
        pause, seen = threading.Event(), dict[int, object]()
        while True:
            pause.wait(CALL_LIMIT_S)
            with self._lock:
                for thread, call in self._running.items():
                    if seen.get(thread) is call:
                        ctypes.pythonapi.PyThreadState_SetAsyncExc(
                            ctypes.c_ulong(thread), ctypes.py_object(TooLongError)
                        )
                seen = self._running.copy()
                if not seen:
                    self._looks = False
                    return


watch = Watch()
atexit.register(watch.rest)
os.register_at_fork(after_in_child=watch.disarm)
