"""The frames of a dbc: layout for the schedulability analysis: a message of its own for every bound page."""

from collections import Counter
from collections.abc import Mapping

from drivers.families.dbc.layout import DbcLayout
from drivers.families.dbc.page import BoundMessage
from drivers.frame import REMOTE
from drivers.protocols.base import SERVICE, Message
from drivers.protocols.read_back import ANSWER_TICKS

OCCASIONAL_NS = 10_000_000  # least period of a command that is not sent every tick


class DbcTraffic(DbcLayout):
    """What the bound messages put on the bus."""

    def messages(self, period_ns: int) -> list[Message]:
        """All commands, then the feedbacks, which the last command triggers, and what is sent less often."""
        titles = self._titles()
        trigger = None if self._free_running else titles[self._cyclic[-1]]
        if self._requests:
            trigger = f"request of {self._requests[-1].name}"
        slow_ns = max(period_ns, OCCASIONAL_NS)
        state_ns = max(period_ns, self.state_ns)
        feedback_ns = self.feedback_ns or period_ns
        feedback = dict.fromkeys(self._feedback)
        senders = self._senders()
        seldom = {m: max(period_ns, self._period_ns.get(m, slow_ns)) for m in self._commands if m not in self._cyclic}
        lone = dict.fromkeys([lone.message for lone in (*self._start, *self._stop)], slow_ns)
        return [
            *(_message(titles[m], m, period_ns, "host") for m in self._cyclic),
            *(
                Message(f"request of {m.name}", REMOTE | m.can_id, 0, False, period_ns, period_ns, 0, "host")
                for m in self._requests
            ),
            *(_message(titles[m], m, feedback_ns, senders[m.can_id], trigger) for m in feedback),
            *(_message(titles[m], m, state_ns, senders[m.can_id]) for m in self._state_only),
            *(_message(titles[m], m, seldom_ns, "host") for m, seldom_ns in (seldom | lone).items()),
            *self._service(period_ns, titles),
            *(self._vesc.messages() if self._vesc else ()),
        ]

    def _senders(self) -> dict[int, str]:
        """The node that sends an identifier: that of the first axis whose values are in it."""
        axes = {page.can_id: axis for page, axis in reversed(self._state_only.items())}
        axes |= {page.can_id: axis for axis, page in reversed([*enumerate(self._feedback)])}
        asked = {asked.answer.message.can_id: asked.axis for asked in reversed(self._read_back)}
        return {can_id: f"axis {axis}" for can_id, axis in (asked | axes).items()}

    def _titles(self) -> dict[BoundMessage, str]:
        """Names of all frames that are sent but questions: of several pages of a message the others have a number."""
        lone = [lone.message for lone in (*self._start, *self._stop)]
        titles: dict[BoundMessage, str] = {}
        seen: Counter[str] = Counter()
        for page in dict.fromkeys([*self._cyclic, *self._heard_pages(), *self._commands, *lone]):
            seen[page.name] += 1
            titles[page] = page.name if seen[page.name] == 1 else f"{page.name} ({seen[page.name]})"
        return titles

    def _service(self, period_ns: int, titles: Mapping[BoundMessage, str]) -> list[Message]:
        """Questions and their answers: of each drive one in ANSWER_TICKS."""
        asked_ns, senders = ANSWER_TICKS * period_ns, self._senders()
        found: dict[int, Message] = {}
        for asked in self._read_back:
            ask, answer = asked.ask.message, asked.answer.message
            name = f"{SERVICE} {ask.name}"
            found.setdefault(ask.can_id, _message(name, ask, asked_ns, "host"))
            found.setdefault(answer.can_id, _message(titles[answer], answer, asked_ns, senders[answer.can_id], name))
        return list(found.values())


def _message(name: str, page: BoundMessage, period_ns: int, sender: str, trigger: str | None = None) -> Message:
    return Message(name, page.can_id, page.length, page.fd, period_ns, period_ns, 0, sender, trigger, page.brs)
