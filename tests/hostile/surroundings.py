"""What is against a command: a table of surroundings, each a way to start it, and what its message has to name.

Files of a run: `place` is where it runs and writes, with `home`, `tmp` and `runtime` below it.
"""

import contextlib
import os
import resource
import signal
import subprocess
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import NamedTuple

NOBODY = 65534
NO_SUCH_USER = 54321  # no line in /etc/passwd: no home can be looked up
INSTANTS = 20
_CGROUP = Path("/sys/fs/cgroup")


class Surroundings(NamedTuple):
    """How one kind of trouble is made.

    prepare: before the start, given the place; in_child: in the child before it becomes the command; prefix: words
    before it; beside: a program in Python that runs as long; environment: over that of the lane, None takes a variable
    away; streams: of (0, 1, 2), a file to open, or None where it is closed. number, after: the signal, and when, as a
    share of the undisturbed run. killed: the kernel may kill it, who can say nothing then. needs: what must be there,
    else it is not run. slow: how much longer it may take. weight: how soon a slice has it.
    """

    prepare: Callable[[Path], None] = lambda place: None
    in_child: Callable[[Path], None] = lambda place: None
    prefix: tuple[str, ...] = ()
    beside: str = ""
    environment: Mapping[str, str | None] = {}
    streams: Mapping[int, str | None] = {}
    number: signal.Signals | None = None
    after: float = 0.0
    killed: bool = False
    needs: tuple[str, ...] = ()
    slow: float = 1.0
    weight: float = 1.0


def mounted(options: str) -> Callable[[Path], None]:
    """A small file system of its own at the place. The lane has mounts that nobody else sees."""

    def mount(place: Path) -> None:
        subprocess.run(["mount", "-t", "tmpfs", "-o", f"mode=0777,{options}", "hostile", place], check=True)

    return mount


def folders(place: Path) -> None:
    """What the environment names, below the place."""
    for name in ("home", "tmp", "runtime"):
        (place / name).mkdir(mode=0o700, exist_ok=True)


def _full(left: int) -> Callable[[Path], None]:
    def fill(place: Path) -> None:
        mounted("size=512k")(place)
        folders(place)
        with (place / "filler").open("wb", buffering=0) as file, contextlib.suppress(OSError):
            while file.write(bytes(4096)):
                pass
        with (place / "filler").open("r+b") as file:
            file.truncate(max(0, (place / "filler").stat().st_size - left))

    return fill


def _read_only(place: Path) -> None:
    mounted("size=512k")(place)
    folders(place)
    subprocess.run(["mount", "-o", "remount,ro", place], check=True)


def _limit(kind: int, size: int) -> Callable[[Path], None]:
    return lambda place: resource.setrlimit(kind, (size, size))


def _become(user: int) -> tuple[str, ...]:
    """The user's words before the command. He may read all, as the interpreter may lie in a folder of root's."""
    reads = ("--inh-caps", "+dac_read_search", "--ambient-caps", "+dac_read_search")
    return ("setpriv", "--reuid", str(user), "--regid", str(user), "--clear-groups", *reads, "--")


def _own(user: int) -> Callable[[Path], None]:
    """All below the place is the user's, as where a person works in a folder of his own."""

    def own(place: Path) -> None:
        place.chmod(0o777)
        folders(place)
        for path in (place, *place.rglob("*")):
            os.chown(path, user, user)

    return own


def _slow_cgroup(place: Path) -> None:
    """A fifth of a core, in a group that the lane has made."""
    for file in (_CGROUP / "cpu/hostile/cgroup.procs", _CGROUP / "hostile/cgroup.procs"):
        if file.exists():
            file.write_text(str(os.getpid()))
            return


def make_cgroup() -> bool:
    """A group with a fifth of a core, of either version; False where this may not be had."""
    with contextlib.suppress(OSError):
        (_CGROUP / "cpu/hostile").mkdir(exist_ok=True)
        (_CGROUP / "cpu/hostile/cpu.cfs_quota_us").write_text("20000")
        return True
    with contextlib.suppress(OSError):
        (_CGROUP / "hostile").mkdir(exist_ok=True)
        (_CGROUP / "hostile/cpu.max").write_text("20000 100000")
        return True
    return False


def make_memory_cgroup() -> bool:
    """A group that may have MOST_MEMORY, of either version; False where this may not be had."""
    for folder, name in ((_CGROUP / "memory/hostile", "memory.limit_in_bytes"), (_CGROUP / "hostile", "memory.max")):
        with contextlib.suppress(OSError):
            folder.mkdir(exist_ok=True)
            (folder / name).write_text(str(MOST_MEMORY))
            return True
    return False


def _little_memory(place: Path) -> None:
    for folder in (_CGROUP / "memory/hostile", _CGROUP / "hostile"):
        if (folder / "cgroup.procs").exists():
            (folder / "cgroup.procs").write_text(str(os.getpid()))
            return


def _first_core(place: Path) -> None:
    """Where the hog is."""
    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})


def _signals(number: signal.Signals) -> dict[str, Surroundings]:
    return {
        f"{number.name} at {at + 1}/{INSTANTS}": Surroundings(number=number, after=(at + 0.5) / INSTANTS, weight=0.15)
        for at in range(INSTANTS)
    }


MOST_MEMORY = 150 * 2**20  # bytes
HOG = """
import os, time
os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(99))
while True:
    until = time.monotonic() + 0.008
    while time.monotonic() < until:
        pass
    time.sleep(0.002)
"""
CLOCK_SETTER = """
import time
for step in (3600.0, -3600.0) * 100_000:
    time.clock_settime(time.CLOCK_REALTIME, time.clock_gettime(time.CLOCK_REALTIME) + step)
    time.sleep(0.2)
"""
POSIX = {"LC_ALL": "POSIX", "LANG": "POSIX", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}

SURROUNDINGS = {
    "undisturbed": Surroundings(),
    "closed input": Surroundings(streams={0: None}),
    "closed output": Surroundings(streams={1: None}),
    "closed errors": Surroundings(streams={2: None}),
    "all three closed": Surroundings(streams={0: None, 1: None, 2: None}),
    "full output": Surroundings(streams={1: "/dev/full"}),
    "full errors": Surroundings(streams={2: "/dev/full"}),
    "both full": Surroundings(streams={1: "/dev/full", 2: "/dev/full"}),
    "full disk": Surroundings(_full(0), needs=("mounts",)),
    "disk with 40 kB left": Surroundings(_full(40_960), needs=("mounts",)),
    "files of 0 bytes": Surroundings(in_child=_limit(resource.RLIMIT_FSIZE, 0)),
    "files of 5000 bytes": Surroundings(in_child=_limit(resource.RLIMIT_FSIZE, 5000)),
    "read-only folder": Surroundings(_read_only, needs=("mounts",)),
    "no home": Surroundings(environment={"HOME": None}),
    "a home that is not there": Surroundings(environment={"HOME": "/nonexistent/home"}),
    "nobody in a folder of another": Surroundings(prefix=_become(NOBODY), needs=("root",)),
    "a user without a name or home": Surroundings(
        _own(NO_SUCH_USER), prefix=_become(NO_SUCH_USER), environment={"HOME": None, "USER": None}, needs=("root",)
    ),
    "POSIX locale": Surroundings(environment=POSIX),
    "24 descriptors": Surroundings(in_child=_limit(resource.RLIMIT_NOFILE, 24)),
    "400 MB of memory": Surroundings(in_child=_limit(resource.RLIMIT_AS, 400 * 2**20)),
    "a fifth of a core": Surroundings(in_child=_slow_cgroup, needs=("cgroup",), slow=8.0),
    "150 MB of a cgroup": Surroundings(in_child=_little_memory, needs=("memory cgroup",), killed=True),
    "a SCHED_FIFO 99 hog": Surroundings(in_child=_first_core, beside=HOG, needs=("guest",), slow=8.0),
    "a clock that is set": Surroundings(beside=CLOCK_SETTER, needs=("guest",)),
    **_signals(signal.SIGINT),
    **_signals(signal.SIGHUP),
}
