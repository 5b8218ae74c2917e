"""The goal page: how goals reach the control process within one tick, and who may send them.

Rules:
- One client at a time holds the lease, named by its uid and pid. It ends by itself LEASE_NS after the last goal or
  heartbeat. Nothing stops with it: every plan in hand ends at rest.
- Nothing in the file, whatever its bytes, can raise in the control process.
- No goal outlives the process it was meant for: each control process makes a new, empty page.
- A goal that has waited longer than GOAL_LIFE_NS is refused, and so is one of a lease that has ended.
- The control process revokes the lease once the rig is no longer ACTIVE. The next who moves it takes a new one.

Theory of operation: as the mailbox (mailbox.py), a memory-mapped ring of slots and two counters. A tick without goals
costs one comparison. Newest wins: a client never waits for room. Where more goals than MOST_A_TICK wait, the oldest are
passed over and counted. Slots that are torn or damaged are dropped and counted. The control process leaves a verdict
beside each slot: a client learns within a tick what became of its goal.
"""

import fcntl
import os
import struct
import time
import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import Final, NamedTuple

from drivers.base.shared_map import shortened, unmap
from hil.cycle.goal import Goal, MotionError, Refusal
from hil.live.mapped_file import Closing, create_page, map_page, replaced

MAGIC: Final = 0x31304C414F474C48  # "HLGOAL01"
SLOTS: Final = 64
SLOT_SIZE: Final = 128
FIRST_SLOT: Final = 256
FIRST_VERDICT: Final = (FIRST_SLOT + SLOTS * SLOT_SIZE) // 8  # word
SIZE: Final = 8 * (FIRST_VERDICT + SLOTS)
MOST_A_TICK: Final = 4
LEASE_NS: Final = 1_000_000_000
GOAL_LIFE_NS: Final = 300_000_000

# u64 words; clients write the first two lines of the cache, the control process the third
_MAGIC: Final = 0
_POSTED: Final = 8
_LEASE: Final = 9  # number of the lease taken last; 0: none was
_HOLDER: Final = 10  # its holder: uid << 32 | pid
_BEAT_NS: Final = 11  # its last sign of life, monotonic ns; 0: given back
_TAKEN: Final = 16
_DAMAGED: Final = 17
_PASSED: Final = 18  # goals passed over, as newer ones had come
_FOREIGN: Final = 19  # goals of a lease that had ended
_STALE: Final = 20
_ANSWERED: Final = 21  # goals whose verdict is there; one without was superseded
_REVOKED: Final = 22  # number of the lease that the control process ended last

# sequence; number, kind, mask, flags, lease; due, valid, posted; position, velocity, speed; CRC-32 of what precedes it
_SLOT: Final = struct.Struct("<QIIIIIqqq4d4ddI")
_BODY: Final = _SLOT.size - 4
_NO_GOALS: Final[tuple[Goal, ...]] = ()
_REFUSALS: Final = frozenset(int(refusal) for refusal in Refusal)


class GoalPageError(MotionError):
    """The page is missing or is none, or another client holds the lease; the text says which."""


class Lease(NamedTuple):
    """Who may send goals. number: rising with every lease. uid, pid: of the holder."""

    number: int
    uid: int
    pid: int

    @property
    def holder(self) -> str:
        """For people."""
        return f"process {self.pid} of user {self.uid}"


class GoalPage(Closing):
    """One end of the page. The control process makes it with `create`; clients attach with `GoalPage(path)`."""

    def __init__(self, path: str | os.PathLike[str]) -> None:
        """Raises GoalPageError."""
        self.path = Path(path)
        try:
            self._fd, self._map = map_page(self.path, SIZE, MAGIC, "goal page")
        except ValueError as error:
            raise GoalPageError(str(error)) from None
        self._words = memoryview(self._map).cast("Q")
        self._taken = self._words[_TAKEN]
        self._damaged = self._passed = self._foreign = self._stale = self.mended = 0
        self._lease = 0  # of a client

    @classmethod
    def create(cls, path: str | os.PathLike[str]) -> "GoalPage":
        """A new, empty page in place of any older one."""
        path = Path(path)
        create_page(path, SIZE, MAGIC)
        return cls(path)

    # ---- the control process's end

    def poll(self, now_ns: int) -> tuple[Goal, ...]:
        """Goals that arrived since the last call, oldest first, the newest MOST_A_TICK of them. Never raises.

        now_ns: monotonic. What the cycle makes of them is told by `answer`.
        """
        posted = self._words[_POSTED]
        if posted == self._taken:
            return _NO_GOALS
        return self._take(posted, now_ns)

    def _take(self, posted: int, now_ns: int) -> tuple[Goal, ...]:
        first = self._taken
        if posted < first:  # no client counts like this
            self._damage()
            first = posted
        elif posted - first > MOST_A_TICK:
            self._passed += posted - first - MOST_A_TICK
            self._words[_PASSED] = self._passed & 0xFFFF_FFFF
            first = posted - MOST_A_TICK
        goals = tuple(goal for index in range(first, posted) if (goal := self._read(index, now_ns)))
        self._taken = posted
        self._words[_TAKEN] = posted
        if not goals:
            self._words[_ANSWERED] = posted
        return goals

    def _read(self, index: int, now_ns: int) -> Goal | None:
        start = FIRST_SLOT + index % SLOTS * SLOT_SIZE
        raw = self._map[start : start + _SLOT.size]  # a copy: what is checked is what is used
        sequence, number, kind, mask, flags, lease, due, valid, sent_ns, *numbers, checksum = _SLOT.unpack(raw)
        if sequence != index + 1 or checksum != zlib.crc32(raw[:_BODY]):
            self._damage()
            return None
        if lease != self._words[_LEASE] or lease == self._words[_REVOKED]:
            self._foreign += 1
            self._words[_FOREIGN] = self._foreign
            self._tell(number, Refusal.FOREIGN)
            return None
        if abs(now_ns - sent_ns) > GOAL_LIFE_NS:  # the tick may have woken just before it was sent
            self._stale += 1
            self._words[_STALE] = self._stale
            self._tell(number, Refusal.STALE)
            return None
        p0, p1, p2, p3, v0, v1, v2, v3, speed = numbers
        return Goal(number, kind, mask, flags, due, valid, (p0, p1, p2, p3), (v0, v1, v2, v3), speed, lease)

    def answer(self, handled: Sequence[tuple[Goal, int]]) -> None:
        """What the cycle made of the goals of the last `poll`."""
        for goal, refusal in handled:
            self._tell(goal.number, refusal)
        self._words[_ANSWERED] = self._taken  # after the verdicts

    def _tell(self, number: int, refusal: int) -> None:
        self._words[FIRST_VERDICT + (number - 1) % SLOTS] = number << 8 | refusal

    def revoke(self) -> None:
        """End the lease of any holder: nobody moves the rig any more."""
        lease = self._words[_LEASE]
        if lease != self._words[_REVOKED]:
            self._words[_REVOKED] = lease

    def lost(self, now_ns: int) -> bool:
        """The client that holds the lease gave no sign of life for LEASE_NS, and did not give it back."""
        beat = self._words[_BEAT_NS]
        return beat != 0 and now_ns - beat > LEASE_NS and self._words[_LEASE] != self._words[_REVOKED]

    def _damage(self) -> None:
        self._damaged += 1
        self._words[_DAMAGED] = self._damaged

    def mend(self) -> None:
        """Write the head anew where the file was cut short or overwritten."""
        if shortened(self._map) or self._words[_MAGIC] != MAGIC:
            self.mended += 1
            self._words[_MAGIC] = MAGIC

    # ---- a client's end

    def take_lease(self, *, by_force: bool = False) -> Lease:
        """Become the one who sends goals; by_force: also where somebody else is. Raises GoalPageError."""
        fcntl.flock(self._fd, fcntl.LOCK_EX)
        try:
            holder = self.holder()
            if holder is not None and not by_force:
                raise GoalPageError(f"{holder.holder} moves this rig already")
            self._lease = (self._words[_LEASE] + 1) & 0xFFFF_FFFF or 1
            self._words[_HOLDER] = os.getuid() << 32 | os.getpid()
            self._words[_LEASE] = self._lease
            self._words[_BEAT_NS] = time.monotonic_ns()
            return Lease(self._lease, os.getuid(), os.getpid())
        finally:
            fcntl.flock(self._fd, fcntl.LOCK_UN)

    def holder(self) -> Lease | None:
        """Who may send goals now; None: nobody."""
        beat = self._words[_BEAT_NS]
        if beat == 0 or time.monotonic_ns() - beat > LEASE_NS or self._words[_LEASE] == self._words[_REVOKED]:
            return None
        name = self._words[_HOLDER]
        return Lease(self._words[_LEASE], name >> 32, name & 0xFFFF_FFFF)

    def beat(self) -> None:
        """Keep the lease. Raises GoalPageError where it has ended."""
        fcntl.flock(self._fd, fcntl.LOCK_EX)
        try:
            self._keep()
        finally:
            fcntl.flock(self._fd, fcntl.LOCK_UN)

    def post(self, goal: Goal) -> int:
        """Send a goal under this client's lease and keep that; the goal's number, which replaces its own.

        Raises GoalPageError where the lease has ended, struct.error for numbers that no slot holds.
        """
        fcntl.flock(self._fd, fcntl.LOCK_EX)
        try:
            self._keep()
            index = self._words[_POSTED]
            number = (index + 1) & 0xFFFF_FFFF
            body = _SLOT.pack(
                index + 1, number, goal.kind, goal.mask, goal.flags, self._lease, goal.due_ns, goal.valid_ns,
                time.monotonic_ns(), *goal.position, *goal.velocity, goal.speed, 0,
            )[:_BODY]  # fmt: skip
            start = FIRST_SLOT + index % SLOTS * SLOT_SIZE
            self._map[start : start + _SLOT.size] = body + struct.pack("<I", zlib.crc32(body))
            self._words[_POSTED] = index + 1  # after the slot: a reader that sees the count sees the goal
            return number
        finally:
            fcntl.flock(self._fd, fcntl.LOCK_UN)

    def verdict(self, number: int) -> Refusal | None:
        """What became of the goal of that number: Refusal.NONE is accepted, None not yet known."""
        answered = self._words[_ANSWERED] & 0xFFFF_FFFF
        found = self._words[FIRST_VERDICT + (number - 1) % SLOTS]
        if found >> 8 == number:
            return Refusal(found & 0xFF) if found & 0xFF in _REFUSALS else Refusal.UNKNOWN
        return Refusal.SUPERSEDED if answered >= number else None

    def give_back(self) -> None:
        """End this client's lease, where it still is this client's."""
        fcntl.flock(self._fd, fcntl.LOCK_EX)
        try:
            if self._lease and self._words[_LEASE] == self._lease:
                self._words[_BEAT_NS] = 0
            self._lease = 0
        finally:
            fcntl.flock(self._fd, fcntl.LOCK_UN)

    def _keep(self) -> None:
        holder = self.holder()
        if holder is None or holder.number != self._lease:
            raise GoalPageError("the lease has ended: take it again")
        self._words[_BEAT_NS] = time.monotonic_ns()

    # ---- either end

    @property
    def counts(self) -> dict[str, int]:
        """Slots the control process found damaged, passed over, of an ended lease, and too old, so far."""
        places = (("damaged", _DAMAGED), ("passed", _PASSED), ("foreign", _FOREIGN), ("stale", _STALE))
        return {name: self._words[at] for name, at in places}

    @property
    def replaced(self) -> bool:
        """Another page took this one's place (a restarted control process)."""
        return replaced(self.path, self._fd)

    def close(self) -> None:
        """Unmap the file, which stays."""
        if not self._map.closed:
            self._words.release()
            unmap(self._map)
            os.close(self._fd)
