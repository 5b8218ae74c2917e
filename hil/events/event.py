"""One event: what it says, and how it reads as a line and as a document."""

import math
import re
from typing import Any, NamedTuple

from hil.events.table import KINDS, Kind, Severity


class Event(NamedTuple):
    """Something that happened.

    name: of the state, fault, command, ... it is about. tick: index of the tick, -1 outside the control loop. time_ns:
    monotonic, of the rig's machine. run_ns: since the run's first slot. axis: name, or empty where it concerns none or
    all. value, limit: what was measured and what it is held against, in `unit`; NaN where nothing is measured.
    measured: what that is. times: how many occurrences this event stands for, itself included.
    """

    kind: Kind
    severity: Severity
    name: str
    tick: int
    time_ns: int
    run_ns: int = 0
    axis: str = ""
    measured: str = ""
    value: float = math.nan
    limit: float = math.nan
    unit: str = ""
    cause: str = ""
    action: str = ""
    times: int = 1

    @property
    def text(self) -> str:
        """What happened, without when, why and what next."""
        words = f"{KINDS[self.kind].text}: {self.name}" + (f" on {self.axis}" if self.axis else "")
        if self.measured and math.isnan(self.limit) and not math.isnan(self.value):  # so or not: no limit to it
            words += f": {self.measured}"
        elif self.measured and not math.isnan(self.limit):
            unit = f" {self.unit}" if self.unit else ""
            words += f": {self.measured} {self.value:.6g}{unit}, limit {self.limit:.6g}{unit}"
        return words + (f" ({self.times} times)" if self.times > 1 else "")

    @property
    def line(self) -> str:
        """All of it in one line."""
        when = f"tick {self.tick} ({self.run_ns * 1e-9:.3f} s): " if self.tick >= 0 else ""
        cause = f"; cause: {self.cause}" if self.cause else ""
        return f"{when}{self.text}{cause}; next: {self.action or 'none'}"

    def pasted(self, rig: str) -> "Event":
        """With that rig's name for NAME in the commands of its next step, so that they can be pasted."""
        return self._replace(action=re.sub(r"\b(hil [a-z]+) NAME\b", rf"\1 {rig}", self.action)) if rig else self

    @property
    def document(self) -> dict[str, Any]:
        """As JSON has it: names for numbers, null where nothing is measured."""
        found = {**self._asdict(), "kind": self.kind.name, "severity": self.severity.name, "line": self.line}
        return {**found, "value": _known(self.value), "limit": _known(self.limit)}


def _known(value: float) -> float | str | None:
    """The number where JSON has one for it. An infinite request was measured, too."""
    if math.isfinite(value):
        return value
    return None if math.isnan(value) else str(value)
