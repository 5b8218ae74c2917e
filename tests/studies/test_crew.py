"""A study that is interrupted leaves its other jobs alone."""

import time
from pathlib import Path

import pytest

from hil.studies.crew import crew


def nap(place: Path) -> None:
    """A job that says that it began, and takes a while."""
    place.touch()
    time.sleep(0.1)


def begin_and_end(ending: type[BaseException], places: list[Path]) -> None:
    """Of two workers' study, after its first result."""
    with crew(2) as found:
        results = found.run(nap, places)
        next(results)
        raise ending  # whose traceback keeps `results`, as that of Ctrl-C does


@pytest.mark.parametrize("ending", [KeyboardInterrupt, RuntimeError])
def test_an_interrupted_study_does_none_of_the_jobs_that_are_left(ending: type[BaseException], tmp_path: Path) -> None:
    places = [tmp_path / str(number) for number in range(40)]
    with pytest.raises(ending):
        begin_and_end(ending, places)
    assert sum(place.exists() for place in places) < 12
