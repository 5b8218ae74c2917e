"""A CAN adapter with fault confinement whose bus is a vcan interface: a live stage behind a bus that can go off."""

import time

from drivers.bus.port import Port
from drivers.frame import Frame
from tests.vm.slcan import SerialAdapter


class RelayingAdapter(SerialAdapter):
    """Carries classic frames between the driver and `beyond`, except while it is in bus-off."""

    def __init__(self, beyond: Port) -> None:
        self._beyond = beyond
        self._partial = ""
        self._off = False
        super().__init__()

    def state(self, letter: str, receive_errors: int, transmit_errors: int) -> None:
        """Report fault confinement; b(us-off) lasts until the driver opens the channel anew."""
        self._off = letter == "b"
        super().state(letter, receive_errors, transmit_errors)

    def told(self, text: str) -> None:
        """Send what is a frame, come back from bus-off by an O."""
        *lines, self._partial = (self._partial + text).split("\r")
        for line in lines:
            if line == "O":
                self._off = False
            elif line.startswith("t") and not self._off:
                self._beyond.send(Frame(int(line[1:4], 16), bytes.fromhex(line[5:])))

    def other_side(self) -> list[int]:
        """The bus beyond."""
        return [self._beyond.fileno()]

    def carry_back(self) -> None:
        """What the bus beyond has said goes to the driver."""
        for frame in self._beyond.drain(time.monotonic_ns()):
            if not self._off:
                self.say(f"t{frame.can_id:03X}{len(frame.data)}{frame.data.hex().upper()}")
