"""A command started in its surroundings, and what became of it."""

import contextlib
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import NamedTuple

from tests.hostile.commands import Case
from tests.hostile.surroundings import Surroundings, folders
from tests.support.paths import ROOT

PATIENCE_S = 60.0
LONGEST_TEXT = 100_000  # bytes of a stream that are looked at


class Ended(NamedTuple):
    """status: as subprocess has it, None where it had to be killed; out, err: None where nobody could read them.
    made: the sizes of all files at its place.
    """

    status: int | None
    out: str | None
    err: str | None
    seconds: float
    made: dict[str, int]


def environment(place: Path, over: Surroundings) -> dict[str, str]:
    """The lane's, with everything a command may write below the place."""
    found: dict[str, str | None] = {
        name: value for name, value in os.environ.items() if not name.startswith(("XDG_", "HIL_", "COLUMNS"))
    }
    found |= {"HOME": str(place / "home"), "TMPDIR": str(place / "tmp"), "HIL_RUNTIME_DIR": str(place / "runtime")}
    found |= {"PYTHONPATH": str(ROOT), "PYTHONDONTWRITEBYTECODE": "1", "OPENBLAS_NUM_THREADS": "1", **over.environment}
    return {name: value for name, value in found.items() if value is not None}


def run(case: Case, over: Surroundings, inputs: Path, place: Path, plain_s: float) -> Ended:
    """Start, perhaps send the signal, wait. plain_s: how long it takes undisturbed."""
    place.mkdir(parents=True)
    place.chmod(0o755)
    folders(place)
    over.prepare(place)
    words = [word.replace("{in}", str(inputs)) for word in case.words]

    def in_child() -> None:
        os.umask(0o022)
        signal.signal(signal.SIGHUP, signal.SIG_DFL)
        over.in_child(place)
        for number, name in over.streams.items():
            os.close(number)
            if name is not None:
                assert os.open(name, os.O_WRONLY) == number
                os.set_inheritable(number, True)

    beside = subprocess.Popen([sys.executable, "-c", over.beside]) if over.beside else None
    began = time.monotonic()
    process = subprocess.Popen(
        [*over.prefix, sys.executable, "-m", "hil", *words], cwd=place, env=environment(place, over),
        stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE, start_new_session=True,
        preexec_fn=in_child,
    )  # fmt: skip
    try:
        _see_it_end(process, case, over, plain_s)
        status: int | None = process.returncode
    except subprocess.TimeoutExpired:
        status = None
    seconds = time.monotonic() - began
    if beside is not None:
        assert beside.poll() is None, "what should have been beside it had ended"
        beside.kill()
        beside.wait()
    with contextlib.suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)
    texts = [text[:LONGEST_TEXT].decode(errors="replace") for text in process.communicate()]
    made = {str(path.relative_to(place)): path.lstat().st_size for path in place.rglob("*") if path.is_file()}
    _clear(place)
    out, err = (None if number in over.streams else text for number, text in enumerate(texts, 1))
    return Ended(status, out, err, seconds, made)


def _see_it_end(process: subprocess.Popen[bytes], case: Case, over: Surroundings, plain_s: float) -> None:
    """Raises subprocess.TimeoutExpired where it does not."""
    sent = [(over.after * plain_s, over.number)] if over.number is not None else []
    if case.ends is not None:
        sent.append((case.ends * over.slow, signal.SIGTERM))
    for after_s, number in sent:
        try:
            process.communicate(timeout=after_s)
            return
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, number)
    process.communicate(timeout=PATIENCE_S * over.slow)


def _clear(place: Path) -> None:
    if os.path.ismount(place):
        subprocess.run(["umount", "-l", place], check=True)
    shutil.rmtree(place, ignore_errors=True)
