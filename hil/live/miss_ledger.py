"""Who lost the slots that a tick ran over: this thread by what it executed, or the host that did not let it run."""

import os
import resource
import threading


def own_share(overrun: int, period_ns: int, cpu_ns: int, blocked: bool) -> int:
    """How many of the slots that a tick ran over were lost by this thread itself; the rest is the host's doing.

    Question asked: had the tick started on its deadline and never been interrupted, over which deadlines would it still
    have run? cpu_ns: CPU time the thread used for that tick, with the wait after it.
    blocked: the thread gave up the CPU other than by its pacing sleep (a page fault, a system call that waited); no
    kernel counter gives the length of that, so all of it is ours. A late wake is never ours: nothing of us ran then.
    """
    if blocked:
        return overrun
    return max(0, min(overrun, (cpu_ns - 1) // period_ns))


class MissLedger:
    """Who lost which slots: this thread, or the host that did not let it run."""

    def __init__(self, period_ns: int) -> None:
        self.own = self.host = self.longest = 0
        self.run_delay_ns = 0  # since the stock-taking before the last one
        self.total_run_delay_ns = 0
        self._period_ns = period_ns
        # /proc/thread-self/schedstat: ns on the core, ns runnable but waiting for it, time slices
        self._schedstat = os.open(f"/proc/self/task/{threading.get_native_id()}/schedstat", os.O_RDONLY | os.O_CLOEXEC)
        self._switches = self._faults = self._sleeps = 0
        self.take_stock(0)

    def take_stock(self, sleeps: int) -> bool:
        """Note run delay and switches since last time; True where the thread blocked other than in its pacing sleep.

        sleeps: pacing sleeps made so far; each accounts for at most one voluntary switch.
        """
        total = int(os.pread(self._schedstat, 96, 0).split()[1])
        self.run_delay_ns = total - self.total_run_delay_ns
        self.total_run_delay_ns = total
        usage = resource.getrusage(resource.RUSAGE_THREAD)
        waited = usage.ru_nvcsw - self._switches > sleeps - self._sleeps
        blocked = waited or usage.ru_majflt > self._faults
        self._switches, self._faults, self._sleeps = usage.ru_nvcsw, usage.ru_majflt, sleeps
        return blocked

    def book(self, skipped: int, overrun: int, cpu_ns: int, sleeps: int) -> None:
        """Slots were lost, `overrun` of them by the tick before them. cpu_ns: its CPU time, with the wait after it."""
        blocked = self.take_stock(sleeps)
        own = own_share(overrun, self._period_ns, cpu_ns, blocked)
        self.own += own
        self.host += skipped - own
        self.longest = max(self.longest, skipped)

    def close(self) -> None:
        """Close the kernel's file."""
        os.close(self._schedstat)
