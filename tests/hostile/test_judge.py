"""The judge of the hostile lane: what it lets pass, and each thing that it does not."""

import os
import signal
from pathlib import Path

import pytest

from hil.cli.app import COMMANDS
from tests.hostile.__main__ import pairs
from tests.hostile.commands import CASES, Case
from tests.hostile.judge import wrong
from tests.hostile.started import Ended, run
from tests.hostile.surroundings import SURROUNDINGS, Surroundings

CASE = Case(("sim",), ("a.json",))
QUIET = Surroundings()
TRACE = "Traceback (most recent call last):\n"


def ended(status: int | None, out: str | None = "done\n", err: str | None = "", **made: int) -> Ended:
    return Ended(status, out, err, 1.0, {name.replace("_", "."): size for name, size in made.items()})


@pytest.mark.parametrize(
    ("over", "found"),
    [
        (QUIET, ended(0, a_json=10)),
        (QUIET, ended(74, err="hil: a.json: No space left on device\n")),
        (QUIET, ended(0, err="tick 5 (0.005 s): overrun\n" * 30, a_json=10)),
        (SURROUNDINGS["closed errors"], ended(74, "", None)),
        (SURROUNDINGS["SIGINT at 5/20"], ended(130, "", "")),
        (SURROUNDINGS["SIGINT at 5/20"], ended(-signal.SIGINT, "", "")),
        (SURROUNDINGS["SIGINT at 1/20"], ended(1, "", TRACE + 'File "/lib/site.py"\nKeyboardInterrupt\n')),
    ],
)
def test_work_done_and_a_line_that_says_why_not_are_right(over: Surroundings, found: Ended) -> None:
    assert wrong(CASE, over, found) == ""


@pytest.mark.parametrize(
    ("found", "why"),
    [
        (ended(0), "status 0 without a.json"),
        (ended(0, a_json=0), "status 0 without a.json"),
        (ended(0, "", "", a_json=10), "without a word"),
        (ended(74, "", ""), "without a word"),
        (ended(1, "", TRACE), "Traceback"),
        (ended(0, "", "Exception ignored in: <stdout>", a_json=10), "Exception ignored"),
        (ended(120, "", "hil: no"), "not documented"),
        (ended(-signal.SIGBUS, "", ""), "SIGBUS"),
        (ended(None), "does not end"),
        (ended(74, "", "line\n" * 30), "30 lines"),
    ],
)
def test_silence_tracebacks_and_unknown_ends_are_not(found: Ended, why: str) -> None:
    assert why in wrong(CASE, QUIET, found)


def test_only_where_the_kernel_may_kill_is_its_kill_right() -> None:
    killed = ended(-signal.SIGKILL, "", "")
    assert wrong(CASE, SURROUNDINGS["150 MB of a cgroup"], killed) == ""
    assert "SIGKILL" in wrong(CASE, QUIET, killed)
    assert "Traceback" in wrong(CASE, SURROUNDINGS["150 MB of a cgroup"], ended(-signal.SIGKILL, "", TRACE))


def test_a_command_that_must_fail_and_does_not_is_told() -> None:
    assert "status 0, where" in wrong(Case(("estop",), status=69), QUIET, ended(0))


def test_every_command_is_tried() -> None:
    named = {name.split()[0] for name in CASES}
    assert {name for group in COMMANDS.values() for name in group} - named == {"dashboard"}, "a name that goes"


def test_a_slice_has_commands_and_surroundings_of_all_kinds_and_another_seed_has_others() -> None:
    first = [pairs("", {"mounts", "root", "cgroup"}, seed)[:100] for seed in ("a", "b")]
    assert len(set(first[0]) & set(first[1])) < 30
    assert len({name for name, _ in first[0]}) > 35
    assert len({at.split(" at ")[0] for _, at in first[0]}) > 15
    assert not {at for _, at in pairs("", set(), "a")} & {"full disk", "a fifth of a core"}


@pytest.mark.long
def test_a_program_beside_runs_as_long_as_the_command_and_no_longer(tmp_path: Path) -> None:
    os.chmod(tmp_path, 0o755)
    beside = f"import time\nwhile True:\n    open({str(tmp_path / 'mark')!r}, 'a').write('x')\n    time.sleep(0.01)"
    assert run(CASES["explain"], Surroundings(beside=beside), tmp_path, tmp_path / "a", 0.0).status == 0
    written = (tmp_path / "mark").stat().st_size
    assert written > 0
    run(CASES["explain"], QUIET, tmp_path, tmp_path / "b", 0.0)
    assert (tmp_path / "mark").stat().st_size == written


@pytest.mark.long
def test_a_run_in_its_surroundings_is_seen_as_it_was(tmp_path: Path) -> None:
    os.chmod(tmp_path, 0o755)
    seen = run(CASES["explain"], QUIET, tmp_path, tmp_path / "a", 0.0)
    assert seen.status == 0
    assert seen.out
    full = run(CASES["explain"], SURROUNDINGS["full output"], tmp_path, tmp_path / "b", 0.0)
    assert (full.status, full.out) == (74, None)
    assert full.err == "hil: standard output: No space left on device\n"
    cut = run(CASES["explain"], Surroundings(number=signal.SIGTERM), tmp_path, tmp_path / "c", 0.0)
    assert cut.status == -signal.SIGTERM
    assert not (tmp_path / "c").exists()
