"""The force learnt over repeats, around a disturbance that is what is missing, and late as an observer says it."""

import numpy as np
import pytest

from hil.control.laws import make_axis_laws, make_law
from hil.control.laws.presliding_kalman import KEPT
from hil.control.laws.repeat_memory import LAG, WARM_REPEATS, RepeatMemory
from hil.rig.schema import LawConfig
from tests.control.test_laws import LIMIT, PERIOD, model

COUNT = 100  # ticks of a repeat
REPEAT_NS = COUNT * 1_000_000


def memory() -> RepeatMemory:
    return RepeatMemory(REPEAT_NS, 0, 1e-3, 5.0)


def play(learnt: RepeatMemory, wanted: list[float], repeats: int, first: int = 0, lag: int = 2 + LAG) -> list[float]:
    """RMS of what is missing in each repeat; the observer says it `lag` ticks late."""
    missing, found = [0.0] * lag, []
    for repeat in range(first, first + repeats):
        total = 0.0
        for slot in range(COUNT):
            tick = repeat * COUNT + slot
            learnt.note(tick, missing[-lag], missing[-lag] * 1e-6, 1.0)
            missing.append(wanted[slot] - learnt.force(tick))
            total += missing[-1] ** 2
        found.append((total / COUNT) ** 0.5)
    return found


def wave(size: float) -> list[float]:
    return (size * np.sin(2.0 * np.pi * np.arange(COUNT) / COUNT)).tolist()


@pytest.mark.parametrize("from_ns", [0, 7_000_000, 7_300_000])
def test_a_tick_of_the_repeats_is_the_nearest_one_to_the_tasks_time(from_ns: int) -> None:
    repeats = RepeatMemory(REPEAT_NS, from_ns, 1e-3, 5.0)
    for tick in (-3, -1, 0, 1, COUNT - 1, COUNT, 10**9):
        exact = from_ns + tick * 1_000_000
        assert {repeats.tick(exact + off) for off in (-500_000, -1000, 0, 1000, 499_999)} == {tick}


def test_what_comes_back_every_repeat_goes_away_and_the_first_repeats_are_left_alone() -> None:
    found = play(memory(), wave(1.0), 12)
    assert found[:WARM_REPEATS] == [pytest.approx(0.7071, abs=1e-3)] * WARM_REPEATS
    assert found[3] < 0.5 * found[0]
    assert max(found[8:]) < 0.02 * found[0]


def test_where_a_repeat_begins_the_memory_says_by_how_much_its_force_is_another_than_before() -> None:
    """In any program: learning, the best once more, none; and from nothing to what was known before."""
    learnt, rng, played = memory(), np.random.default_rng(5), [0.0] * COUNT
    learnt.begin_with([0.25] * COUNT)
    steps = [0.0]
    for tick in range(-3, 30 * COUNT):
        learnt.note(tick, rng.normal(), rng.normal() * 1e-6, 1.0)
        force, slot = learnt.force(tick), tick % COUNT
        expected = force - played[slot] if slot == 0 and tick >= 0 else 0.0
        assert learnt.steps == (steps[-1], expected)
        if tick >= 0:
            played[slot] = force
        steps.append(expected)
    assert steps[4] == 0.25
    assert sum(step != 0.0 for step in steps) > 10


def test_what_is_missing_is_the_mean_of_seven_samples_that_weighs_the_middle_most() -> None:
    learnt = memory()
    for tick in range(COUNT):
        learnt.note(tick, 1.0 if tick == 12 else 0.0, 0.0, 1.0)
        learnt.force(tick)
    assert [value for value in learnt._missing if value != 0.0] == [k / 16.0 for k in (1, 2, 3, 4, 3, 2, 1)]


def test_a_changed_stage_is_learnt_anew() -> None:
    learnt = memory()
    play(learnt, wave(1.0), 12)
    found = play(learnt, wave(-1.0), 12, first=12)
    assert found[0] > 1.0
    assert found[-1] < 0.05


def test_learning_that_harms_is_undone_within_three_repeats() -> None:
    """An observer that says the opposite of what is missing."""
    learnt, worse, at = memory(), [], 0.0
    missing = [0.0] * 8
    for tick in range(40 * COUNT):
        learnt.note(tick, -missing[-4], missing[-4], 1.0)
        missing.append(wave(1.0)[tick % COUNT] - learnt.force(tick))
        at += missing[-1] ** 2
        if tick % COUNT == COUNT - 1:
            worse.append((at / COUNT) ** 0.5 > 1.1 * 0.7071)
            at = 0.0
    longest = max(len(run) for run in "".join("x" if bad else " " for bad in worse).split(" "))
    assert 0 < longest <= 3


def without_learning(learnt: RepeatMemory, *sizes: float, every: int = 1) -> list[bool]:
    """Whether each repeat after the warm ones is run without learning, by the errors (um) seen in all of them. every:
    in later ones, one sample of so many comes.
    """
    found = []
    for tick in range(len(sizes) * COUNT):
        comes = tick < WARM_REPEATS * COUNT or tick % every == 0
        learnt.note(tick, 0.1, sizes[tick // COUNT] * 1e-6, float(comes))
        learnt.force(tick)
        if tick % COUNT == COUNT - 1:
            found.append(learnt.frozen == 0.0)
    return found[WARM_REPEATS:]


WARM = [1.0] * WARM_REPEATS


def test_learning_pauses_after_two_repeats_in_a_row_that_were_worse_than_without_it() -> None:
    assert not any(without_learning(memory(), *WARM, 1.0, 1.2, 1.0, 1.2, 1.0, 0.5))
    assert without_learning(memory(), *WARM, 1.0, 1.2, 1.2, 1.0, 1.0) == [False, False, False, True, False]
    assert not any(without_learning(memory(), *WARM, 1.0, 1.05, 1.05, 1.05, 1.05))
    seen = without_learning(memory(), *WARM, 1.0, 1.2, 1.2, 1.0, 1.0, every=3)
    assert seen == [False, False, False, True, False], "of the samples that came, on average"


def test_after_three_repeats_that_were_worse_and_none_that_was_better_no_more_is_learnt() -> None:
    worse = [1.2, 1.0, 1.2, 1.0, 1.2]
    assert without_learning(memory(), *WARM, *worse, *[1.0] * 4) == [False] * 5 + [True] * 4
    assert without_learning(memory(), *WARM, 1.2, 1.2, 1.0, 1.2, *[1.0] * 9)[3:] == [False] + [True] * 9
    # One that was better, and they are counted anew.
    assert not any(without_learning(memory(), *WARM, 1.2, 1.0, 1.2, 0.8, 1.2, 1.0, 1.2, 1.0))
    for last, kept in ((1.0, True), (1.2, False)):
        learnt = memory()
        without_learning(learnt, *WARM, *worse[:-1], last, 1.0)
        assert any(learnt.best()) is kept


def test_a_stage_that_has_changed_gets_three_more_repeats_to_learn_in() -> None:
    given_up = [1.2, 1.0, 1.2, 1.0, 1.2, 1.0]
    found = without_learning(memory(), *WARM, *given_up, 1.4, 1.6, 2.0, 2.0, 2.0, 2.0)
    assert found[6:] == [True, True, False, False, True, False]


def test_what_was_begun_with_is_not_given_up_before_it_was_compared() -> None:
    """The first repeat of a run that begins with something says nothing of what is left without it."""
    learnt = memory()
    learnt.begin_with([0.25] * COUNT)
    found = without_learning(learnt, *WARM, 1.2, 1.0, 1.2, 1.0, 1.2, 1.0, 1.2, 1.0, 1.2, 1.2, 9.0, 1.2, 1.2)
    assert found == [False] * 9 + [False, True, False, False]


def test_the_best_of_a_run_is_what_the_next_one_begins_with() -> None:
    first, again = memory(), memory()
    play(first, wave(1.0), 12)
    best = first.best()
    assert len(best) == COUNT
    again.begin_with(best)
    best[0] = 99.0  # a list of its own
    assert first.best()[0] != 99.0
    assert play(again, wave(1.0), 1)[0] < 0.02
    with pytest.raises(ValueError, match=r"law\.learnt: it has 99 ticks of a repeat, the task 100"):
        again.begin_with(best[1:])


def test_a_law_begins_with_the_weights_and_tables_of_an_earlier_run() -> None:
    law = make_law(
        LawConfig(name="presliding-kalman", iterative_learning=True), model(), PERIOD, LIMIT, repeat=(REPEAT_NS, 0)
    )
    fresh = law.learnt_state()
    state = [value + 1e-4 * (number + 1) for number, value in enumerate(fresh)]
    law.begin_learnt(state)
    assert np.array_equal(law.learnt_state()[0], fresh[0])  # from the next start on
    law.reset(np.zeros(2), model().gravity)
    for kept, wanted in zip(law.learnt_state()[:KEPT], state, strict=False):
        assert np.array_equal(kept, wanted)
    with pytest.raises(ValueError, match=r"law\.learnt: it has 3 values"):
        law.begin_learnt(state[:3])


def test_a_spoilt_sample_teaches_nothing() -> None:
    learnt = memory()
    for tick in range((WARM_REPEATS + 3) * COUNT):
        learnt.note(tick, 1.0, 1e-6, 0.0)
        assert learnt.force(tick) == 0.0


def test_the_length_of_a_repeat_is_checked() -> None:
    def made(ns: int) -> None:
        make_law(LawConfig(name="presliding-kalman", iterative_learning=True), model(), PERIOD, LIMIT, repeat=(ns, 0))

    made(14_000_000)
    with pytest.raises(ValueError, match="not a multiple"):
        made(100_000_500)
    with pytest.raises(ValueError, match="repeats every 13 ticks; 14 to 100000 can be learnt"):
        made(13_000_000)
    with pytest.raises(ValueError, match="repeats every 100001 ticks"):
        made(100_001_000_000)
    with pytest.raises(ValueError, match="does not repeat"):
        make_axis_laws(LawConfig(name="presliding-kalman", iterative_learning=True), model(), PERIOD, LIMIT)
    wrong = LawConfig(name="presliding-kalman", gains={"learning_rate": 0.5}, iterative_learning=True)
    with pytest.raises(ValueError, match=r"law\.gains\.learning_rate"):
        make_law(wrong, model(), PERIOD, LIMIT)


def test_floats_and_arrays_learn_the_same_bits() -> None:
    rng = np.random.default_rng(3)
    many = RepeatMemory(REPEAT_NS, 0, 1e-3, np.full(2, 0.4))
    each = [RepeatMemory(REPEAT_NS, 0, 1e-3, 0.4) for _ in range(2)]
    for tick in range(12 * COUNT):
        d, e = rng.normal(size=2), rng.normal(size=2) * 1e-6 * (1.0 + (tick > 6 * COUNT))
        good = np.array([1.0, float(tick % 97 != 0)])
        many.note(tick, d, e, good)
        together = many.force(tick)
        for i, one in enumerate(each):
            one.note(tick, float(d[i]), float(e[i]), float(good[i]))
            assert one.force(tick) == together[i]


def test_what_else_learns_is_frozen_from_the_start_where_something_is_known_and_when_learning_begins() -> None:
    fresh, known = memory(), memory()
    known.begin_with([0.25] * COUNT)
    assert (fresh.frozen, known.frozen) == (0.0, 1.0)
    play(fresh, wave(1.0), WARM_REPEATS)
    assert fresh.frozen == 0.0
    play(fresh, wave(1.0), 1, first=WARM_REPEATS)
    assert fresh.frozen == 1.0
    for learnt in (fresh, known):
        play(learnt, wave(1.0), 3, first=WARM_REPEATS + 1)
        learnt.forget()
    assert (fresh.frozen, known.frozen) == (0.0, 1.0)


def test_after_a_worse_repeat_the_best_is_played_once_more_to_the_bit_and_then_it_learns_on() -> None:
    learnt, rng, forces = memory(), np.random.default_rng(3), []
    for repeat, size in enumerate([1.0] * (WARM_REPEATS + 1) + [0.5, 0.7, 0.5, 0.5]):
        played = []
        for tick in range(repeat * COUNT, (repeat + 1) * COUNT):
            learnt.note(tick, rng.normal(), size * 1e-6, 1.0)
            played.append(learnt.force(tick))
        forces.append(played)
    good, worse, again, on = forces[-4:]
    assert worse != good == again != on
    assert forces[:WARM_REPEATS] == [[0.0] * COUNT] * WARM_REPEATS
