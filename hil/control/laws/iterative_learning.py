"""Iterative learning over a repeated task, around any law: what the last cycle's error asks for is added in the next.

Learning by plant inversion (Bristow, Tharayil, Alleyne, IEEE Control Systems 26(3), 2006, section "Plant inversion"),
on the closed loop as the law leaves it. A force u over one period moves the error by m ë + kd ė + kp e = u. With the
centred differences below the learning step is 1 - rate cos^2(omega T / 2) for the inertial part. It is real, within [0,
1] at every frequency up to the Nyquist one. So an event shorter than the loop's bandwidth (friction that reverses
between two samples) is learnt too, without phase error.
"""

from typing import Any, ClassVar

from hil.control.gain import Gain, with_defaults
from hil.control.laws.base import Law, LawInputs, Model
from hil.control.number import Number, bounded, zeros_like

LEARNING_GAINS: dict[str, Gain] = {
    "learning_rate": Gain(0.9, "1", "part of the error corrected from one repeat to the next"),
    "learning_decay": Gain(0.02, "1", "how much slower each repeat learns than the one before"),
    "learning_kp": Gain(0.0, "N/m", "stiffness of the inner loop; default: the law's kp"),
    "learning_kd": Gain(0.0, "N s/m", "damping of the inner loop; default: the law's kd"),
    "learning_inertia": Gain(1.0, "1", "fraction of the nominal mass"),
}
SAMPLES = 4  # errors a step is made of
MOST_TICKS = 100_000  # of a repeat: a few megabytes an axis, forgotten in about a millisecond when the law is reset


class IterativeLearning(Law):
    """The law `inner` plus a learnt force per tick of the task's period.

    u(i) <- u(i) - g (M a + learning_kd v + learning_kp e), where e, v, a are the error, its rate and its acceleration
    in the interval i in which u(i) acted. The gain is g = learning_rate / (1 + learning_decay j) in repeat j, so that
    late repeats average noise. The gains learning_kp and learning_kd are those of the inner loop: make_law takes the
    inner law's kp and kd. M is learning_inertia times the nominal mass.

    Most inner laws never see the learnt force: an observer that only adds what is missing would take it for a
    disturbance and undo it. A filter that predicts where the axis will be must be told of all that moves it, or it
    takes the learnt force for errors of its model, and both diverge together. What it feeds forward then leaves the
    learning only what the model cannot say (Law.told_of_learning). The learnt force stays within half the force limit
    and is not changed in ticks with missing samples or a force at its limit.
    """

    GAINS: ClassVar[dict[str, Gain]] = LEARNING_GAINS

    def __init__(
        self,
        inner: Law,
        model: Model,
        period: float,
        force_limit: Number,
        repeat_ns: int,
        repeat_from_ns: int,
        **gains: Any,
    ) -> None:
        given = with_defaults(self.GAINS, gains)
        rate: Number = given["learning_rate"]
        decay: Number = given["learning_decay"]
        learning_kp: Number = given["learning_kp"]
        learning_kd: Number = given["learning_kd"]
        learning_inertia: Number = given["learning_inertia"]
        self._inner = inner
        self._period_ns = round(period * 1e9)
        if repeat_ns % self._period_ns:
            raise ValueError(
                f"law.iterative_learning: the task repeats every {repeat_ns} ns, not a multiple of the period "
                f"{self._period_ns} ns"
            )
        self._count = repeat_ns // self._period_ns
        if self._count > MOST_TICKS:
            raise ValueError(
                f"law.iterative_learning: the task repeats every {self._count} ticks; "
                f"at most {MOST_TICKS} can be learnt"
            )
        self._from_ns = repeat_from_ns
        self._rate, self._decay = rate, decay
        self._limit = force_limit
        # Weights of e(i-1), e(i), e(i+1), e(i+2) for the interval from sample i to i+1.
        inertia = learning_inertia * model.mass / (2.0 * period * period)
        told = inner.told_of_learning
        damping = (inner.damping if told else learning_kd) * (1.0 / period)
        stiffness = (inner.stiffness if told else learning_kp) * 0.5
        self._weights = (inertia, stiffness - damping - inertia, stiffness + damping - inertia, inertia)
        self.coupled = inner.coupled
        self.preview = inner.preview
        self.reset(zeros_like(model.mass), zeros_like(model.mass))

    def reset(self, position: Number, force: Number) -> None:
        """Everything learnt is forgotten."""
        self._inner.reset(position, force)
        zero = zeros_like(position)
        self._learnt = [zero] * self._count
        self._errors, self._good = [zero] * SAMPLES, [zero] * SAMPLES
        self._last, self._before = zero, zero

    def force(self, inputs: LawInputs) -> Number:
        """The inner law's force and what has been learnt for this tick."""
        # To the nearest tick: the latency that stamps are measured by moves by a microsecond now and then.
        tick = (inputs.task_ns - self._from_ns + self._period_ns // 2) // self._period_ns
        self._learn(inputs, tick)
        last, before = inputs.force_last, inputs.force_before
        if not self._inner.told_of_learning:
            inputs.force_last, inputs.force_before = last - self._last, before - self._before
        try:
            asked = self._inner.force(inputs)
        finally:
            inputs.force_last, inputs.force_before = last, before
        self.denominator_floors = self._inner.denominator_floors
        self._before = self._last
        self._last = self._learnt[tick % self._count] if tick >= 0 else zeros_like(self._last)
        return asked + self._last

    def _learn(self, inputs: LawInputs, tick: int) -> None:
        """The newest sample is that of the tick before; with it the interval three ticks back has its four errors."""
        errors, good = self._errors, self._good
        del errors[0], good[0]
        errors.append(inputs.position - inputs.sample.position)
        good.append(inputs.fresh * (abs(inputs.force_before) < self._limit))
        index = tick - 3
        if index < 1:
            return
        w0, w1, w2, w3 = self._weights
        missing = w0 * errors[0] + w1 * errors[1] + w2 * errors[2] + w3 * errors[3]
        rate = self._rate / (1.0 + self._decay * (index // self._count))
        step = rate * missing * (good[0] * good[1] * good[2] * good[3])
        slot = index % self._count
        self._learnt[slot] = bounded(self._learnt[slot] - step, 0.5 * self._limit)
