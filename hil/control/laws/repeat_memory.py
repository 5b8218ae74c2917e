"""A force learnt over a task that repeats, written for floats and arrays: what an observer still finds is added in the
next repeat.

    u(i) <- u(i) + q (u(i-1) - 2 u(i) + u(i+1)) + rate d(i + lag)

Here d is the observer's disturbance, smoothed over seven samples without a shift: it speaks of force, where an error's
second difference would speak of noise. The filter q keeps what repeats add by themselves from growing at high
frequencies. It is a Q-filter (Bristow, Tharayil, Alleyne, IEEE Control Systems 26(3), 2006). Each repeat is judged by
the mean square of its error:

- more than WORSE of the best: the best force is played again, and learning goes on from it at half the rate;
- the best, played again, is more than CHANGED off: the stage has changed, and learning is as quick as at first;
- two repeats in turn worse than the one without: one is run without, and learning begins anew;
- MOST_HARM repeats worse than without since one that was better: no more is learnt, until the repeats without change.
"""

from hil.control.number import Number, at_least, at_most, bounded, copy, select, zeros_like

WARM_REPEATS = 2  # the law by itself: what it learns by other means comes first
RATE, LEAST_RATE = 0.7, 0.1
SMOOTHING = 0.05  # q
WORSE, CHANGED, USELESS = 1.21, 2.25, 1.21  # of mean squares
MOST_HARM = 3.0
SAMPLES = 7  # weighed 1, 2, 3, 4, 3, 2, 1
# Periods that the observer's disturbance is behind: with 3, a rigid axis' learning would grow at 140 Hz; with 1,
# that of an axis with a mode at 150 Hz, at 96 Hz (hil/analysis/learning_check.py).
LAG = 2
DELAY = 2 + SAMPLES // 2 + LAG  # ticks from the interval in which a force acts until what was missing in it is known
LEAST_TICKS, MOST_TICKS = 2 * DELAY, 100_000  # of a repeat; a few megabytes an axis


class RepeatMemory:
    """Of one axis (floats), or of many (arrays of one shape).

    repeat_ns, from_ns: length and beginning of the repeats, ns of task time. limit: of the learnt force, N. frozen: 1.0
    where what else learns must not, as it would learn against this. steps: by how much the last two forces differ from
    what the repeat before had in their place, N, where a repeat begins; else 0. A disturbance that is noted is what is
    left after the first of them. Raises ValueError naming law.iterative_learning.
    """

    def __init__(self, repeat_ns: int, from_ns: int, period: float, limit: Number) -> None:
        self._period_ns = round(period * 1e9)
        if repeat_ns % self._period_ns:
            raise ValueError(
                f"law.iterative_learning: the task repeats every {repeat_ns} ns, not a multiple of the period "
                f"{self._period_ns} ns"
            )
        self._count = repeat_ns // self._period_ns
        if not LEAST_TICKS <= self._count <= MOST_TICKS:
            raise ValueError(
                f"law.iterative_learning: the task repeats every {self._count} ticks; "
                f"{LEAST_TICKS} to {MOST_TICKS} can be learnt"
            )
        self._from_ns, self._limit = from_ns, limit
        self._start: list[Number] = []  # what it begins with; empty: with nothing
        self.forget()

    def begin_with(self, force: list[Number]) -> None:
        """What an earlier run came to, N, by tick; `forget` returns to that. Raises ValueError naming law.learnt."""
        if len(force) != self._count:
            raise ValueError(f"law.learnt: it has {len(force)} ticks of a repeat, the task {self._count}")
        self._start = [bounded(value, self._limit) for value in force]
        self.forget()

    def keep(self) -> None:
        """`forget` returns to the best force from now on."""
        self._start = self.best()

    def start(self) -> list[Number]:
        """What `forget` returns to, N, by tick."""
        return self._start or [zeros_like(self._limit)] * self._count

    def best(self) -> list[Number]:
        """The force that left least, N, by tick; none where no more is learnt."""
        given_up = self._harm >= MOST_HARM
        return [select(given_up, zeros_like(value), value) for value in self._best]

    def forget(self) -> None:
        """As at the start."""
        zero = zeros_like(self._limit)
        self._force: list[Number] = self._start[:] if self._start else [zero] * self._count
        self._best: list[Number] = self._force[:]
        self._missing: list[Number] = [zero] * self._count
        self._history: list[Number] = [zero] * SAMPLES
        self._spoilt = zero  # samples until the history has nothing of a spoilt one
        self._squares, self._samples = zero, zero
        self._least, self._without = zero, zero  # mean squares of the best repeat and of the last one without
        self._rate = zero + RATE
        self._replays, self._pauses = zero, zero  # 1.0 where this repeat plays the best; none
        self._useless = zero  # repeats in turn that were worse than without
        self._harm = zero  # repeats worse than without since one that was better
        self._compared = zero if self._start else zero + 1.0  # 1.0 once a repeat was run without
        self._before = zero  # the learnt force of the slot before, as it was
        self._repeat, self._begun, self._learns = 0, False, False
        self.steps, self._stepped = (zero, zero), zero  # in all in this repeat
        self.frozen = zero + 1.0 if self._start else zero

    def tick(self, task_ns: int) -> int:
        """Of the repeats, to the nearest: the latency that stamps are measured by moves by a microsecond."""
        return (task_ns - self._from_ns + self._period_ns // 2) // self._period_ns

    def note(self, tick: int, disturbance: Number, error: Number, good: Number) -> None:
        """What the sample seen in this tick says: N, m; good: 1.0, or 0.0 where it says nothing."""
        step = self.steps[0]
        self._history = h = [value - step for value in self._history[1:]]
        h.append(copy(disturbance))
        self._stepped = self._stepped + step
        self._spoilt = select(good > 0.0, at_least(self._spoilt - 1.0, 0.0), 0.0 * good + SAMPLES)
        if tick < 0:
            return
        self._squares = self._squares + good * (error * error)
        self._samples = self._samples + good
        acted = tick - DELAY
        if acted >= 0:
            found = (h[0] + h[6]) + 2.0 * (h[1] + h[5]) + 3.0 * (h[2] + h[4]) + 4.0 * h[3]
            found = found * (1.0 / 16.0)
            if acted < self._repeat * self._count:
                found = found + self._stepped  # what was left in the repeat before
            self._missing[acted % self._count] = select(self._spoilt > 0.0, 0.0 * found, found)

    def force(self, tick: int) -> Number:
        """Learnt for the interval that begins now, N."""
        force = step = zeros_like(self._limit)
        if tick >= 0:
            force, step = self._program(tick // self._count, tick % self._count)
        self.steps = (self.steps[1], step)
        return force

    def _program(self, repeat: int, slot: int) -> tuple[Number, Number]:
        """The force of a slot, and its step."""
        zero = zeros_like(self._limit)
        begins = repeat > self._repeat
        if begins:
            self._judge(repeat)
        old, best = self._force[slot], self._best[slot]
        if not self._learns:
            first, self._begun = not self._begun, True
            return old, old if first else zero  # before the first repeat there was none
        after = self._force[slot + 1] if slot + 1 < self._count else old
        before = self._before if slot else old
        more = SMOOTHING * (before - 2.0 * old + after) + self._rate * self._missing[slot]
        again, none = self._replays > 0.0, self._pauses > 0.0
        learnt = select(none, zero, select(again, best, bounded(old + more, self._limit)))
        self._best[slot] = select(self._replays + self._pauses > 0.0, best, old)
        self._force[slot], self._before, self._missing[slot] = learnt, old, zero
        return learnt, learnt - old if begins else zero

    def _judge(self, repeat: int) -> None:
        """The repeat that has just ended, and what the next one is to be."""
        square = self._squares / at_least(self._samples, 1.0)
        zero = zeros_like(square)
        one = zero + 1.0
        self._squares, self._samples, self._stepped, self._repeat = zero, zero, zero, repeat
        if repeat < WARM_REPEATS and not self._start:
            return
        if not self._learns:
            self._learns = True
            self._least, self._without, self.frozen = square, square, one
            return
        again, none = self._replays > 0.0, self._pauses > 0.0
        measured = self._replays + self._pauses > 0.0
        worse = select(measured, zero, select(square > WORSE * self._least, one, zero))
        changed = select(again, select(square > CHANGED * self._least, one, zero), zero)
        harmful = select(none, zero, select(square > USELESS * self._without, one, zero))
        useless = (self._useless + 1.0) * harmful
        helped = select(none, zero, select(USELESS * square < self._without, one, zero))
        harm = select(helped > 0.0, zero, self._harm + harmful * self._compared)
        given_up = self._harm >= MOST_HARM
        harm = select(given_up & (square > CHANGED * self._without), zero, harm)
        self._least = select(measured, square, at_most(square, self._least))
        self._without = select(none & (self._harm < MOST_HARM), square, self._without)
        self._compared = at_least(self._compared, self._pauses)
        slower = at_least(0.5 * self._rate, LEAST_RATE)
        rate = select(worse > 0.0, slower, self._rate)
        self._rate = select(changed + self._pauses > 0.0, RATE * one, rate)
        self._pauses = select((useless > 1.0) | (harm >= MOST_HARM), one, zero)
        self._useless, self._harm = select(useless > 1.0, zero, useless), harm
        self._replays = worse * (1.0 - self._pauses)
        self.frozen = 1.0 - self._pauses
