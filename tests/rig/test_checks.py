"""What a rig is told before anything runs, of its bus, its loop and its task, has not changed. Where a change is meant,
`python -m tests.support.reference checks` renews tests/reference/checks.json.
"""

from typing import Any

import pytest

from hil.rig.file import load_rig
from tests.support.check_reference import BUSES, LOOPS, TASKS, bus_of, known, loop_of, others, rounded, task_of
from tests.support.paths import RIGS

KNOWN = known()


def test_everything_that_is_known_is_looked_at() -> None:
    assert (KNOWN["bus"].keys(), KNOWN["loop"].keys(), KNOWN["task"].keys()) == (set(BUSES), set(LOOPS), set(TASKS))
    assert len({str(found) for part in ("bus", "loop", "task") for found in KNOWN[part].values()}) > 30, (
        "they do differ"
    )


@pytest.mark.parametrize("name", BUSES)
def test_a_bus_carries_what_it_always_did(name: str) -> None:
    rig, sets = BUSES[name]
    assert rounded(bus_of(load_rig(RIGS / f"{rig}.toml", sets))) == KNOWN["bus"][name]


@pytest.mark.parametrize("name", LOOPS)
def test_a_loop_bears_what_it_always_did(name: str) -> None:
    assert rounded(loop_of(load_rig(RIGS / "paper.toml", LOOPS[name]))) == KNOWN["loop"][name]


@pytest.mark.parametrize("name", TASKS)
def test_a_task_asks_for_what_it_always_did(name: str) -> None:
    assert rounded(task_of(load_rig(RIGS / "microscope-ideal.toml", TASKS[name]))) == KNOWN["task"][name]


def test_a_new_rig_is_written_and_two_are_compared_as_ever() -> None:
    told: dict[str, Any] = rounded(others())
    assert told == {key: KNOWN[key] for key in told}
