"""What a tick of the compiled build takes in instructions, which no other work on the machine changes."""

import pytest

from hil.operate.bench.live_runs import BenchError, private_bus, undisturbed
from tests.benchmarks.instructions import TICK, counted, missing, per_tick
from tests.support.paths import RIGS

RIG = RIGS / "microscope-ideal.toml"
MOST = 88_000


def test_a_profile_says_what_a_tick_takes() -> None:
    profile = (
        f"fn=(4) other\n1 5\ncfn=(7) {TICK}\ncalls=3 0\n1 40\nfn=(7)\n1 30\ncfn=(7)\ncalls=1 0\n1 9\ntotals: 120\n"
    )
    assert per_tick(profile) == 30.0


@pytest.mark.live
@pytest.mark.slow
@pytest.mark.skipif(bool(missing()), reason=missing())
def test_a_live_tick_of_four_axes_takes_no_more_instructions_than_it_did() -> None:
    try:
        with private_bus():
            count, _ = undisturbed(lambda: counted(RIG, ["law.name=pd-feedforward", "task.kind=hold"], ticks=200))
    except BenchError as error:
        pytest.skip(f"this host is too busy: {error}")
    assert 10_000 < count < MOST
