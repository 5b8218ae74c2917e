"""`kind = "dbc"`: outputs that are signals of one message of a DBC file. 0 is off, 1 is on; other signals are 0."""

from collections.abc import Mapping
from pathlib import Path
from typing import Final

from drivers.frame import BRS, FD, Frame
from drivers.outputs.config import OutputConfig
from drivers.protocols.base import LayoutError, Reject
from drivers.protocols.dbc_codec import compile_codec, message_of_node, switches_rate

_NOTHING: Final[tuple[int, ...]] = ()


class DbcOutputFrame:
    """An OutputWriter for the outputs of one message, by name. Raises LayoutError naming the key."""

    def __init__(self, outputs: Mapping[str, OutputConfig], base_dir: Path) -> None:
        name, config = next(iter(outputs.items()))
        self._key = f"outputs.{name}"
        self._message = message = message_of_node(
            self._key, base_dir / config.file, config.can_id, fd=config.fd, what="output"
        )
        codec = compile_codec(message)
        self._pack, self._values = codec.pack, [0] * len(codec.names)
        places = {signal: place for place, signal in enumerate(codec.names)}
        self._places = [
            (output.bit, self._place(f"outputs.{name}.signal", output.signal, places))
            for name, output in outputs.items()
        ]
        self._counter, self._wrap = -1, 1
        if config.counter:
            self._counter = self._place(f"{self._key}.counter", config.counter, places)
            signal = message.get_signal_by_name(config.counter)
            self._wrap = 1 << signal.length - bool(signal.is_signed)  # one with a sign stays above 0
        self._can_id, self._flags = config.can_id, 0
        if config.fd:
            self._flags = FD | BRS if switches_rate(message) else FD
        self.bits = sum(1 << output.bit for output in outputs.values())
        self.ready, self.can_ids, self.problem = True, _NOTHING, ""

    def _place(self, key: str, name: str, places: dict[str, int]) -> int:
        """Of a signal that carries whole numbers as they are."""
        if name not in places:
            there = ", ".join(places) or "none"
            raise LayoutError(f"{key} = '{name}': message {self._message.name} has {there}")
        signal = self._message.get_signal_by_name(name)
        whole = not signal.is_float and (signal.scale, signal.offset) == (1, 0)
        if not whole or signal.length < 1 + bool(signal.is_signed):
            raise LayoutError(f"{key} = '{name}': it carries no 0 and 1; expected whole numbers, factor 1, offset 0")
        return places[name]

    def frame(self, bits: int, sequence: int) -> Frame:
        """See OutputWriter."""
        for bit, place in self._places:
            self._values[place] = bits >> bit & 1
        if self._counter >= 0:
            self._values[self._counter] = sequence % self._wrap
        return Frame(self._can_id, self._pack(*self._values), self._flags)

    def hear(self, frame: Frame) -> Reject:
        """It answers with nothing."""
        return Reject.UNKNOWN_ID

    def service(self) -> Frame | None:
        """It needs nothing."""
        return None
