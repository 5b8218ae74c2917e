"""The same run has the same bytes, whoever runs it and whatever else the machine does; `make hashes` runs longer."""

import pytest

from tests.support.hashes import RUNS, VERSIONS, NoInterpreterError, Situation, ask, interpreter, situations

TICKS = 600
NAMES = list(RUNS)


@pytest.fixture(scope="module")
def expected() -> dict[str, str]:
    found = ask(situations()[0], NAMES, TICKS)
    assert len(set(found.values())) == len(NAMES)
    return found


@pytest.mark.requirement(id="SR-9.2")
@pytest.mark.long
@pytest.mark.parametrize("situation", situations()[1:], ids=lambda situation: situation.name)
def test_nothing_around_a_run_changes_a_bit_of_it(situation: Situation, expected: dict[str, str]) -> None:
    assert ask(situation, NAMES, TICKS) == expected


@pytest.mark.long
@pytest.mark.parametrize("version", VERSIONS)
def test_every_python_computes_the_same(version: str, expected: dict[str, str]) -> None:
    try:
        python = interpreter(version)
    except NoInterpreterError as reason:
        pytest.skip(str(reason))
    assert ask(Situation(version, python, {}), NAMES, TICKS) == expected


@pytest.mark.long
def test_a_hash_tells_runs_apart_by_a_single_bit_of_the_seed(expected: dict[str, str]) -> None:
    from tests.support.hashes import run_hash

    rig, overrides = RUNS["microscope-ideal, losses"]
    assert run_hash(rig, overrides, TICKS) == expected["microscope-ideal, losses"]
    assert run_hash(rig, (*overrides, "wire.seed=2"), TICKS) != expected["microscope-ideal, losses"]
