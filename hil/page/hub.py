"""One rig and those who watch it: 25 turns a second for as long as there are any, none otherwise."""

import asyncio
import contextlib
import json
from collections.abc import Awaitable, Callable
from typing import Any, Final, NamedTuple

from hil.cycle.fault_table import Fault
from hil.cycle.goal import MotionWord
from hil.cycle.state_machine import State
from hil.page.frames import Block, Pulse, envelope, pulse_message, ticks
from hil.page.margins import margins
from hil.page.rig_facts import cell_places, clean
from hil.page.ring_feed import RingFeed
from hil.page.sidecar_feed import SidecarFeed

TURN_S: Final = 0.04
WAITING: Final = 50  # messages for a viewer that does not take them: two seconds
MOST_CHOSEN: Final = 8  # signals of which a viewer may have every tick
HEARD_S: Final = 1.0  # a status older than that is none


class Heard(NamedTuple):
    """status: as the page has it (hil/page/words.py); empty: the sidecar is not heard. axes: kind by name."""

    status: dict[str, Any]
    axes: dict[str, str]


class Viewer:
    """One open page. send: to its browser; texts are JSON. waiting: messages for it that are kept, at most."""

    def __init__(self, name: str, waiting: int = WAITING) -> None:
        self.name = name
        self.chosen: tuple[int, ...] = ()
        self.told = 0  # events
        self.news = 0  # of cells
        self.described = -1  # run that it has the description of
        self.dropped = 0
        self._waiting: asyncio.Queue[bytes | str] = asyncio.Queue(waiting)

    def offer(self, message: bytes | str) -> None:
        """Put a message behind the others; where too many wait, the oldest goes. Never waits."""
        if self._waiting.full():
            self._waiting.get_nowait()
            self.dropped += 1
        self._waiting.put_nowait(message)

    def choose(self, text: str, signals: int) -> None:
        """What a browser asks for: {"ticks": [numbers of signals]}. Raises ValueError."""
        wanted = json.loads(text)
        chosen = wanted.get("ticks") if isinstance(wanted, dict) else None
        if not isinstance(chosen, list) or len(chosen) > MOST_CHOSEN:
            raise ValueError(f"ticks: expected a list of at most {MOST_CHOSEN} numbers of signals")
        if any(type(number) is not int or not 0 <= number < signals for number in chosen):
            raise ValueError(f"ticks: numbers of signals are 0 to {signals - 1}")
        self.chosen = tuple(chosen)

    async def pump(self, send: Callable[[bytes | str], Awaitable[None]]) -> None:
        """Send what is offered, for ever."""
        while True:
            await send(await self._waiting.get())


class Hub:
    """rig: its name."""

    def __init__(self, rig: str) -> None:
        self.rig = rig
        self.ring = RingFeed(rig)
        self.ring.turn()
        key = str(self.ring.metadata["rig"]["telemetry"]["key"]) if self.ring.metadata else "hil"
        self.sidecar = SidecarFeed(rig, key)
        self.viewers: set[Viewer] = set()
        self.operator = ""
        self._task: asyncio.Task[None] | None = None
        self._status: dict[str, Any] = {}
        self._computing = asyncio.Lock()
        self._margins: tuple[int, dict[str, Any]] | None = None  # of which run

    def join(self, viewer: Viewer) -> None:
        """From now on it gets every turn."""
        self.viewers.add(viewer)
        if self._task is None or self._task.done():
            self.ring.skip()
            self._task = asyncio.get_running_loop().create_task(self._run())

    def leave(self, viewer: Viewer) -> None:
        """It is gone; an operator whose last page this was operates no more."""
        self.viewers.discard(viewer)
        if self.operator and all(each.name != self.operator for each in self.viewers):
            self.operator = ""

    def take(self, name: str, *, over: bool = False) -> bool:
        """Make somebody the operator, where nobody is or `over` says to take it from the one who is."""
        if over or self.operator in ("", name):
            self.operator = name
        return self.operator == name

    async def _run(self) -> None:
        loop = asyncio.get_running_loop()
        due_s = loop.time()
        while self.viewers:
            self.turn()
            due_s = max(due_s + TURN_S, loop.time())  # a turn that is missed is not made up for
            await asyncio.sleep(due_s - loop.time())

    def turn(self) -> None:
        """Read what is new, once, and offer it to everybody."""
        block = self.ring.turn()
        pulse = self.ring.pulse(self.sidecar.age_s)
        common = pulse_message(pulse) if block is None else envelope(pulse, block)
        status = self.sidecar.status
        fresh = status is not self._status
        self._status = status
        told, news = (self.sidecar.told, self.sidecar.news) if fresh else (0, 0)
        text = json.dumps({"status": {**status, "operator": self.operator}}) if fresh else ""
        chosen: dict[tuple[int, ...], bytes] = {}
        for viewer in self.viewers:
            self._describe(viewer)
            viewer.offer(common)
            if text:
                viewer.offer(text)
            if block is not None and viewer.chosen:
                viewer.offer(self._ticks(chosen, pulse, block, viewer.chosen))
            if told > viewer.told:
                viewer.told, events = self.sidecar.events(viewer.told)
                viewer.offer(json.dumps({"events": events}))
            if news > viewer.news:
                viewer.news, cells = self.sidecar.cells(self.ring.run_id, viewer.news)
                viewer.offer(json.dumps({"cells": cells}))

    @staticmethod
    def _ticks(made: dict[tuple[int, ...], bytes], pulse: Pulse, block: Block, chosen: tuple[int, ...]) -> bytes:
        if chosen not in made:
            made[chosen] = ticks(pulse, block, chosen)
        return made[chosen]

    def _describe(self, viewer: Viewer) -> None:
        """What the numbers of the following messages mean, once a run."""
        if viewer.described != self.ring.run_id:
            viewer.described = self.ring.run_id
            viewer.chosen = tuple(number for number in viewer.chosen if number < len(self.ring.signals))
            viewer.offer(json.dumps({"run": self.description()}))
            status = {**self.sidecar.status, "operator": self.operator}
            viewer.offer(json.dumps({"status": status}))
            viewer.told, events = self.sidecar.events(0)
            viewer.offer(json.dumps({"events": events}))
            viewer.news = 0

    def description(self) -> dict[str, Any]:
        """The rig, its axes and signals; without signals where no control process has left a ring."""
        metadata = self.ring.metadata
        axes = metadata["rig"]["axes"] if metadata else {}
        described = {
            "rig": self.rig,
            "run": str(self.ring.run_id),
            "rate": float(metadata["rig"]["rate_hz"]) if metadata else None,
            "law": str(metadata["rig"]["law"]["name"]) if metadata else "",
            "task": str(metadata["rig"]["task"]["kind"]) if metadata else "",
            "axes": [{"name": name, "kind": axis["kind"]} for name, axis in axes.items()],
            "signals": [signal._asdict() for signal in self.ring.signals],
            "states": {int(state): state.name for state in State},
            "faults": {int(fault): fault.name for fault in Fault},
            "motions": {int(word): word.name for word in MotionWord},
            "cells": cell_places(metadata["rig"]) if metadata else [],
        }
        found: dict[str, Any] = clean(described)
        return found

    async def margins(self) -> dict[str, Any]:
        """Of the run's loop; computed once a run, whoever asks."""
        async with self._computing:
            if self._margins is None or self._margins[0] != self.ring.run_id:
                run, metadata = self.ring.run_id, self.ring.metadata
                self._margins = run, clean(await margins(metadata))
            return self._margins[1]

    def heard(self) -> Heard:
        """What is known now, without a viewer."""
        status = self.sidecar.status if self.sidecar.age_s < HEARD_S else {}
        return Heard(status, {axis["name"]: axis["kind"] for axis in self.description()["axes"]})

    async def close(self) -> None:
        """Let go of everything."""
        self.viewers.clear()
        if self._task:
            self._task.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await self._task
        await asyncio.to_thread(self.sidecar.close)
        self.ring.close()
