"""The inbox's fast path against the rules written down plainly: same verdicts on every history, wraps included."""

from collections.abc import Sequence
from struct import pack

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from drivers.frame import Frame
from drivers.protocols.base import Message, Reject, Sample
from hil.cycle.inbox import SUSPICIOUS, Inbox

AXES = 2
LEAK_TICKS = 7
SENDERS = 2  # identifiers that speak in turn
CAME_NS = 5_000  # when a tick's first frame came; the next ones a nanosecond later each


class AnyLayout:
    """A layout whose frames carry the number of what they decode to."""

    name, n_axes, checksum, fd, echo_id, problems = "any", AXES, True, True, None, ()

    def __init__(self, modulus: int) -> None:
        self.sequence_modulus = modulus
        self.outcomes: list[Sample | Reject | tuple[Sample, ...]] = []

    def messages(self, period_ns: int) -> list[Message]:
        return []

    def decode(self, frame: Frame) -> Sample | Reject | tuple[Sample, ...]:
        return self.outcomes[frame.data[0]]

    def frames(self, outcomes: Sequence[Sample | Reject | tuple[Sample, ...]]) -> list[Frame]:
        self.outcomes = list(outcomes)
        return [Frame(number % SENDERS, bytes([number]), 0, CAME_NS + number) for number in range(len(outcomes))]


class ReadAtOnce(AnyLayout):
    """One whose answers and own echoes are read at once, as in C, up to the first frame that is neither."""

    def answers(self, frames: Sequence[Frame]) -> bytes:
        read = b""
        for frame in frames:
            one = self.decode(frame)
            if one is Reject.OWN_ECHO:
                read += pack("<6q", -1, 0, 0, 0, 0, 0)
                continue
            if not isinstance(one, Sample):
                break
            read += pack("<6q", one.axis, one.position, one.status, one.sequence, one.stamp_ns, frame.timestamp_ns)
        return read


class PlainInbox:
    """The rules of hil/cycle/inbox.py, one after the other and with whole numbers: a command's number never wraps here,
    and an answer's is the newest one not yet ruled out that it can stand for.
    """

    def __init__(self, modulus: int) -> None:
        self.modulus = modulus
        self.newest: list[int | None] = [None] * AXES  # command whose answer was taken last
        self.samples: list[Sample | None] = [None] * AXES
        self.heard, self.age = [False] * AXES, [0] * AXES
        self.rejects = [0] * len(Reject)
        self.received = [0] * AXES
        self.kept = self.bad = self.late = self.lost = self.ticks = 0

    def forget(self) -> None:
        self.newest, self.heard, self.age, self.bad = [None] * AXES, [False] * AXES, [0] * AXES, 0
        self.kept = 0

    def collect(self, outcomes: Sequence[Sample | Reject], sent: int) -> None:
        self.fresh, self.differ = [False] * AXES, -1
        useless, served = 0, set()
        for number, outcome in enumerate(outcomes):
            if isinstance(outcome, Sample):
                self.received[outcome.axis] = CAME_NS + number
            reason = self.verdict(outcome, sent) if isinstance(outcome, Sample) else outcome
            if reason is not None:
                self.rejects[reason] += 1
                if reason is Reject.SERVICE:
                    served.add(number % SENDERS)
                useless += reason is not Reject.OWN_ECHO
                self.bad += reason in SUSPICIOUS
                self.kept += isinstance(outcome, Sample) and reason is Reject.STALE and self.heard[outcome.axis]
                self.kept += reason is Reject.INVALID_VALUE
        self.useless = useless - len(served)
        if sent < 0:
            return
        for axis, fresh in enumerate(self.fresh):
            self.heard[axis] |= fresh
            self.lost += self.heard[axis] and not fresh
            self.age[axis] = 0 if fresh else self.age[axis] + 1
        self.ticks += 1
        if self.ticks % LEAK_TICKS == 0:
            self.bad = max(self.kept, self.bad - 1)

    def verdict(self, sample: Sample, sent: int) -> Reject | None:
        axis, half = sample.axis, self.modulus // 2
        if self.modulus:
            previous = self.newest[axis]
            if previous is not None:
                ahead = (sample.sequence - previous) % self.modulus
                due = sent >= 0 and (sent - sample.sequence) % self.modulus == 0
                if ahead == 0 or (ahead > half and not due):
                    taken = self.samples[axis]
                    if not ahead and taken and taken.sequence == sample.sequence and taken != sample:
                        self.fresh[axis], self.differ = False, axis
                    return Reject.STALE if ahead else Reject.DUPLICATE
            behind = (sent - sample.sequence) % self.modulus
            if sent < 0 or behind > half:
                return Reject.STALE
            self.newest[axis] = sample.sequence
            if behind:
                self.late += 1
                return None
        else:
            self.late += self.fresh[axis]
        self.samples[axis], self.fresh[axis] = sample, True
        return None


# What one tick may bring: answers by how far behind the latest command they are, and what is no sample.
distances = st.one_of(st.sampled_from([0, 0, 0, 1, 2, -1]), st.integers(-300, 300))
answers = st.tuples(st.integers(0, AXES - 1), distances)
others = st.sampled_from(
    [Reject.BAD_CHECKSUM, Reject.UNKNOWN_ID, Reject.SERVICE, Reject.SERVICE, Reject.OWN_ECHO, Reject.INVALID_VALUE]
)
one_tick = st.tuples(
    st.lists(answers | others, max_size=5),
    st.sampled_from([1, 1, 1, 1, 0, 2, 3]),  # commands sent since: 0 where nothing was, as in silence
    st.sampled_from([False] * 15 + [True]),  # a reset
)


def play(layout: AnyLayout, first: int, ticks: list[tuple[list[tuple[int, int] | Reject], int, bool]]) -> None:
    modulus = layout.sequence_modulus
    plain = PlainInbox(modulus)
    inbox, sent = Inbox(layout, LEAK_TICKS), first
    for number, (brought, more, reset) in enumerate(ticks):
        if reset:
            inbox.forget()
            plain.forget()
        outcomes: list[Sample | Reject] = []
        for position, what in enumerate(brought):
            if isinstance(what, Reject):
                outcomes.append(what)
            else:
                axis, distance = what
                sequence = (sent - distance) % modulus if modulus else -1
                outcomes.append(Sample(axis, 100 * number + position, 0, sequence, number))
        inbox.collect(layout.frames(outcomes), sent)
        plain.collect(outcomes, sent)
        assert inbox.fresh == plain.fresh
        assert inbox.samples == plain.samples
        assert (inbox.age, inbox.heard) == (plain.age, plain.heard)
        assert inbox.rejects == plain.rejects
        assert (inbox.bad_frames, inbox.late, inbox.lost) == (plain.bad, plain.late, plain.lost)
        assert (inbox.useless_now, inbox.differ_axis) == (plain.useless, plain.differ)
        assert inbox.received_ns == plain.received
        assert inbox.oldest() == max(plain.age)
        sent += more


@pytest.mark.requirement(id="SR-3.2")
@given(st.sampled_from([0, 16, 256, 65536]), st.integers(-1, 600), st.lists(one_tick, max_size=40))
@example(16, 14, [([(0, 0)], 1, False), ([(0, 0)], 1, False), ([(0, 2)], 1, False), ([(0, 0), (0, 0)], 1, False)])
@example(16, -1, [([(0, 0)], 1, False)] * 3)
@example(0, 0, [([(0, 0), (0, 0)], 1, False)] * 3)
@example(16, 5, [([(0, 0)], 0, False), ([(0, 0)], 1, True)])
@example(16, 0, [([(1, 8)], 1, False), ([(1, 0)], 1, False)])
@example(16, 0, [([(0, 0)], 1, False), *[([], 1, False)] * 9, ([(0, 0)], 1, False)])
@example(16, -1, [([(0, -3)], 1, False)])
@example(16, 0, [([Reject.BAD_CHECKSUM], 1, False), *[([], 1, False)] * LEAK_TICKS])
@example(16, 0, [([Reject.INVALID_VALUE], 1, False), *[([], 1, False)] * LEAK_TICKS])
@example(16, -1, [([(0, 0)], 1, False), *[([], 1, False)] * LEAK_TICKS])
@example(16, 0, [([(0, 0)], 1, False), *[([], 1, False)] * 6, ([(0, 1)], 1, False)])
@example(16, 0, [([(0, 0)], 1, False), *[([], 1, False)] * 8, ([(0, 1)], 1, False)])
@example(16, 0, [([Reject.BAD_CHECKSUM] * 3, 1, False), *[([], 1, False)] * (3 * LEAK_TICKS)])
def test_the_fast_path_and_the_rules_judge_every_history_alike(
    modulus: int, before_wrap: int, ticks: list[tuple[list[tuple[int, int] | Reject], int, bool]]
) -> None:
    for layout in (AnyLayout, ReadAtOnce):
        play(layout(modulus), before_wrap, ticks)
        if modulus and before_wrap >= 0:
            play(layout(modulus), 3 * modulus - before_wrap % 8, ticks)  # over the wrap


@pytest.mark.parametrize("modulus", [256, 65536])
def test_across_a_wrap_only_the_answer_to_the_latest_command_is_believed(modulus: int) -> None:
    layout = AnyLayout(modulus)
    inbox = Inbox(layout, LEAK_TICKS)
    for sent in range(2 * modulus - 4, 2 * modulus + 4):
        due = Sample(0, sent, 0, sent % modulus, 0)
        old = [Sample(1, sent - back, 0, (sent - back) % modulus, 0) for back in (2, 1)]
        inbox.collect(layout.frames([due, *old]), sent)
        assert inbox.fresh == [True, False]
        assert inbox.samples == [due, None]
    assert inbox.age == [0, 8]


def test_one_frame_may_carry_the_answers_of_several_axes() -> None:
    layout = AnyLayout(16)
    inbox, both = Inbox(layout, LEAK_TICKS), (Sample(0, 7, 0, 3, 0), Sample(1, 8, 0, 3, 0))
    inbox.collect(layout.frames([both]), 3)
    assert (inbox.samples, inbox.fresh) == (list(both), [True, True])
    inbox.collect(layout.frames([(both[0],)]), 4)
    assert (inbox.fresh, inbox.rejects[Reject.DUPLICATE]) == ([False, False], 1)


def test_damage_that_nobody_can_be_blamed_for_blames_nobody() -> None:
    layout = AnyLayout(16)
    inbox = Inbox(layout, LEAK_TICKS)
    inbox.collect(layout.frames([Reject.BAD_CHECKSUM]), 0)
    assert (inbox.bad_frames, inbox.suspect_axis) == (1, -1)
