"""Damaged rig, scenario and DBC files: a clear error or a right answer, soon, in little memory, no traceback."""

import random
import resource
import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType

import pytest

from drivers.protocols.dbc_codec import LayoutError, compile_codec, load_dbc
from hil.rig.bus_load import rig_messages
from hil.rig.file import load_rig
from hil.rig.schema import RigError
from sim_plant.scenario.language import ScenarioError, load_scenario
from tests.support.paths import RIGS

LONGEST_S = 2  # of processor time
MOST_MB = 300
LONGEST_REFUSAL = 60_000  # characters
FILES = 10_000
SCENARIOS = RIGS.parent / "scenarios"
PIECES = [
    b"",
    b"\x00",
    b"\xff",
    b"\n",
    b'"',
    b"'''",
    b"[[",
    b"]]",
    b"{",
    b"}",
    b"=",
    b".",
    b"#",
    b"nan",
    b"inf",
    b"-1",
    b"1e999",
    b"9" * 400,
    b"0x" + b"f" * 5000,
    b"[" * 2000,
    b"a." * 3000,
    b"true",
    b"1979-05-27",
    b"\\",
    b"x" * 70_000,
    b"BO_ 1 M: 8 A\n",
    b"99999999",
    b":",
    b"|",
    b"@",
    b'SG_ S : 0|8@1+ (1,0) [0|1] "" B\n',
    b"SG_MUL_VAL_ 1 A B 0-4294967295;",
    b"(0,0)",
    b"0|0",
]


def damaged(text: bytes, chance: random.Random) -> bytes:
    """The text with one to five pieces cut out, doubled, moved, replaced, or numbers exchanged."""
    data = bytearray(text)
    for _ in range(chance.randint(1, 5)):
        first = chance.randrange(len(data) + 1)
        last = min(len(data), first + chance.choice([0, 1, 1, 2, 5, 20, 100]))
        way = chance.randrange(4)
        if way == 0:
            data[first:last] = chance.choice(PIECES)
        elif way == 1:
            data[first:first] = data[first:last] * chance.choice([1, 1, 2, 50])
        elif way == 2:
            piece = data[first:last]
            del data[first:last]
            place = chance.randrange(len(data) + 1)
            data[place:place] = piece
        elif first < len(data):
            data[first] = chance.randrange(256)
    return bytes(data)


@contextmanager
def at_most(seconds: float) -> Iterator[None]:
    """Raise TimeoutError after so much processor time of this process."""

    def over(_number: int, _frame: FrameType | None) -> None:
        raise TimeoutError(f"over {seconds} s")

    before = signal.signal(signal.SIGPROF, over)
    signal.setitimer(signal.ITIMER_PROF, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.signal(signal.SIGPROF, before)


def read_rig(path: Path) -> None:
    rig_messages(load_rig(path), RIGS)


def read_dbc(path: Path) -> None:
    for message in load_dbc(path).messages:
        compile_codec(message)


KINDS: dict[str, tuple[list[Path], Callable[[Path], object], tuple[type[Exception], ...]]] = {
    "rig": (sorted(RIGS.glob("*.toml")), read_rig, (RigError,)),
    "scenario": (sorted(SCENARIOS.glob("*.toml")), load_scenario, (ScenarioError,)),
    "dbc": (sorted(RIGS.glob("*.dbc")), read_dbc, (LayoutError,)),
}


def try_files(kind: str, number: int, seed: int, folder: Path) -> dict[str, int]:
    """Read so many damaged files. Returns how many were good still and how many were refused."""
    originals, read, refusals = KINDS[kind]
    chance, counts = random.Random(seed), {"read": 0, "refused": 0}
    path = folder / "damaged"
    for index in range(number):
        path.write_bytes(damaged(chance.choice(originals).read_bytes(), chance))
        try:
            with at_most(LONGEST_S):
                read(path)
            counts["read"] += 1
        except refusals as refusal:
            text = str(refusal)
            if not text.startswith((str(path), "bus.protocol", "signal ")) or len(text) > LONGEST_REFUSAL:
                raise AssertionError(f"{kind}, seed {seed}, file {index}: {text[:1000]}") from None
            counts["refused"] += 1
        except Exception as error:
            raise AssertionError(f"{kind}, seed {seed}, file {index}: {type(error).__name__}: {error}") from error
    return counts


@pytest.mark.filterwarnings("ignore::hil.rig.former_keys.FormerKeyWarning")
@pytest.mark.parametrize("kind", KINDS)
def test_a_hundred_damaged_files_are_read_or_refused(kind: str, tmp_path: Path) -> None:
    counts = try_files(kind, 100, 1, tmp_path)
    assert min(counts.values()) > 0  # damage in a comment does no harm


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::hil.rig.former_keys.FormerKeyWarning")
@pytest.mark.parametrize("kind", KINDS)
def test_ten_thousand_damaged_files_are_read_or_refused_in_little_memory(kind: str, tmp_path: Path) -> None:
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    counts = try_files(kind, FILES, 2, tmp_path)
    assert sum(counts.values()) == FILES
    assert (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / 1024 < MOST_MB


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        ("BO_ 1 M: 99999999 A\n", "frame length 99999999: allowed 0 to 64"),
        ('BO_ 1 M: 8 A\n SG_ S : 0|99999999@1+ (1,0) [0|1] "" B\n', "signal length 99999999"),
        ('BO_ 1 M: 8 A\n SG_ S : 9999|8@1+ (1,0) [0|1] "" B\n', "signal's first bit 9999"),
        ("SG_MUL_VAL_ 1 A B 0-4294967295;\n", "multiplexer value 4294967295"),
        ("//" + "x" * 2**18 + "\n", "longer than 262144 bytes"),
        ('CM_ "' + "\\" * 100_000, "not a usable DBC file"),
    ],
)
def test_a_dbc_file_that_would_take_minutes_is_refused(content: str, reason: str, tmp_path: Path) -> None:
    path = tmp_path / "odd.dbc"
    path.write_text(content)
    with pytest.raises(LayoutError) as caught, at_most(LONGEST_S):
        load_dbc(path)
    assert reason in str(caught.value)
    assert len(str(caught.value)) < 1000
