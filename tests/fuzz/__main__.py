"""python -m tests.fuzz [KIND ...] --files N --seed N: damaged files of each kind, read in a process of bounded memory.

Every file has to be read or refused by name within two seconds of processor time and MOST_MB beside what the process
has when it begins. Prints, for each kind, how many were read and refused, the longest time and the memory. Exit
status 1 at the first that was not; the file is kept and named.
"""

import argparse
import json
import os
import random
import resource
import signal
import subprocess
import sys
import tempfile
import threading
import time
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

LONGEST_S = 2.0  # of processor time a file
STUCK_S = 60.0  # without a word from the child, on a busy machine
MOST_MB = 300
LONGEST_REFUSAL = 60_000  # characters
_NAMED_OTHERWISE = ("bus.protocol", "signal ")  # by the rig file's key, and by a message's signal
_WORD_EVERY = 20  # files


class FoundError(Exception):
    """A file was neither read nor refused as it must be; the text says which and what came of it."""


@contextmanager
def at_most(seconds: float) -> Iterator[None]:
    """Raise TimeoutError after so much processor time of this process."""

    def over(_number: int, _frame: object) -> None:
        raise TimeoutError(f"over {seconds} s")

    before = signal.signal(signal.SIGPROF, over)
    signal.setitimer(signal.ITIMER_PROF, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.signal(signal.SIGPROF, before)


def _bound_memory() -> None:
    """No more than MOST_MB beside what there is: whoever asks for more gets a MemoryError."""
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0])
    most = pages * resource.getpagesize() + MOST_MB * 2**20
    resource.setrlimit(resource.RLIMIT_AS, (most, most))


def _resident_mb() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def child(name: str, files: int, seed: int, folder: Path) -> None:
    """Read damaged files; a line of JSON now and then to standard output, the last with the counts."""
    from tests.fuzz.kinds import KINDS

    warnings.simplefilter("ignore")
    kind = KINDS[name]
    originals = kind.originals(folder)
    kind.read(originals[0])  # what is imported on first use
    contents = [path.read_bytes() for path in originals]
    path = folder / f"damaged.{kind.suffix}"
    chance = random.Random(f"{name} {seed}")
    counts: dict[str, Any] = {"kind": name, "read": 0, "refused": 0, "longest_s": 0.0}
    began_mb = _resident_mb()
    _bound_memory()
    for index in range(files):
        path.write_bytes(kind.damage(chance.choice(contents), chance))
        counts["longest_s"] = max(counts["longest_s"], _one(name, kind, path, index, counts))
        if index % _WORD_EVERY == 0:
            print(json.dumps({"index": index}), flush=True)
    print(json.dumps({**counts, "grown_mb": round(_resident_mb() - began_mb, 1)}), flush=True)


def _one(name: str, kind: Any, path: Path, index: int, counts: dict[str, Any]) -> float:
    began = time.process_time()
    try:
        with at_most(LONGEST_S):
            kind.read(path)
        counts["read"] += 1
    except kind.refusals as refusal:
        text = str(refusal)
        named = str(path) in text or text.startswith(_NAMED_OTHERWISE)
        if not named or len(text) > LONGEST_REFUSAL or "\x1b" in text or "\0" in text:
            raise FoundError(f"{name}, file {index}, {path}: refused by {text[:500]!a}") from None
        counts["refused"] += 1
    except Exception as error:
        raise FoundError(f"{name}, file {index}, {path}: {type(error).__name__}: {error}") from error
    return time.process_time() - began


def tried(name: str, files: int, seed: int) -> dict[str, Any]:
    """The counts of one kind, from a process of its own. Raises FoundError; the damaged file is then kept."""
    folder = Path(tempfile.mkdtemp(prefix=f"hil-fuzz-{name}-"))
    words = [name, "--files", str(files), "--seed", str(seed), "--child", str(folder)]
    line = [sys.executable, "-m", "tests.fuzz", *words]
    last: dict[str, Any] = {}
    with subprocess.Popen(
        line, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env={**os.environ, "OPENBLAS_NUM_THREADS": "1"}
    ) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        stuck = threading.Event()

        def give_up() -> None:
            stuck.set()
            process.kill()

        said: list[str] = []
        drain = threading.Thread(target=lambda: said.append(process.stderr.read()))  # type: ignore[union-attr]
        drain.start()
        while True:
            timer = threading.Timer(STUCK_S, give_up)
            timer.start()
            text = process.stdout.readline()
            timer.cancel()
            if not text:
                break
            last = json.loads(text)
        drain.join()
        status = process.wait()
    if stuck.is_set():
        raise FoundError(f"{name}, after file {last.get('index')}, in {folder}: no end within {STUCK_S:g} s")
    if status or "read" not in last:
        raise FoundError(f"{name}, seed {seed}, in {folder}: status {status}\n{said[0][-3000:]}")
    for path in folder.iterdir():
        path.unlink()
    folder.rmdir()
    return last


def main(arguments: Sequence[str]) -> int:
    """Returns the exit status."""
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz", description=__doc__)
    parser.add_argument("kinds", nargs="*")
    parser.add_argument("--files", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--child", type=Path, help=argparse.SUPPRESS)
    asked = parser.parse_args(arguments)
    if asked.child:
        child(asked.kinds[0], asked.files, asked.seed, asked.child)
        return 0
    from tests.fuzz.kinds import KINDS

    status = 0
    for name in asked.kinds or KINDS:
        began = time.monotonic()
        try:
            print(json.dumps({**tried(name, asked.files, asked.seed), "seconds": round(time.monotonic() - began, 1)}))
        except FoundError as error:
            print(error, file=sys.stderr)
            status = 1
        sys.stdout.flush()
    return status


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
