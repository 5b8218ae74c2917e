"""A serial CAN adapter played by the test, behind the kernel's slcan driver.

QEMU's emulated controllers never have errors. This one has whatever the test says: the driver (a real one, with the
CAN framework's fault confinement behind it) hears an adapter report error counters, missing acknowledgements and
bus-off in the adapter's own language (Lawicel ASCII), and reacts as it does with hardware.
"""

import contextlib
import fcntl
import os
import pty
import select
import struct
import termios
import threading
import tty

from tests.vm import links

N_SLCAN = 17  # linux/tty.h
SIOCGIFNAME = 0x8910


class SerialAdapter:
    """The adapter's end of the serial line; `name` is the network interface that the driver made for it."""

    def __init__(self) -> None:
        self._adapter, self._line = pty.openpty()
        tty.setraw(self._adapter)
        tty.setraw(self._line)
        os.set_blocking(self._adapter, False)
        fcntl.ioctl(self._line, termios.TIOCSETD, struct.pack("=i", N_SLCAN))
        answer = fcntl.ioctl(self._line, SIOCGIFNAME, bytes(16))
        self.name = answer.partition(b"\0")[0].decode()
        self._text = ""
        self._text_lock = threading.Lock()
        self._open = True
        self._attentive = threading.Event()  # reading what the driver says, without which it says no more
        self._attentive.set()
        self._reader = threading.Thread(target=self._listen, daemon=True)
        self._reader.start()

    def _listen(self) -> None:
        while self._open:
            if not self._attentive.wait(0.1) or not select.select([self._adapter, *self.other_side()], [], [], 0.1)[0]:
                continue
            with contextlib.suppress(OSError):  # nothing there; or the line hangs up when it is closed
                told = os.read(self._adapter, 65536).decode()
                with self._text_lock:
                    self._text += told
                self.told(told)
            self.carry_back()

    def other_side(self) -> list[int]:
        """Descriptors of what an adapter relays to, if it does; `carry_back` is called when they are readable."""
        return []

    def told(self, text: str) -> None:
        """The driver has told the adapter this, in pieces as they come."""

    def carry_back(self) -> None:
        """Take what has come from the other side."""

    def stall(self) -> None:
        """Read nothing more: the line fills up, as with a controller that gets nothing onto the wire."""
        self._attentive.clear()

    def up(self, bitrate: int, queue: int = 16) -> None:
        """Configure and start the interface, as networkd would."""
        links.ip("link", "set", self.name, "txqueuelen", str(queue))
        links.ip("link", "set", self.name, "up", "type", "can", "bitrate", str(bitrate))

    def down(self) -> None:
        """Take the interface down."""
        links.ip("link", "set", self.name, "down")

    def say(self, line: str) -> None:
        """What the adapter tells the driver: t... a frame, s... a state, e... an error."""
        data = f"{line}\r".encode()
        while data:
            select.select([], [self._adapter], [], 1.0)
            data = data[os.write(self._adapter, data) :]

    def state(self, letter: str, receive_errors: int, transmit_errors: int) -> None:
        """Report fault confinement: a(ctive), w(arning), p(assive), b(us-off), with its counters."""
        self.say(f"s{letter}{receive_errors:03d}{transmit_errors:03d}")

    def heard(self, wanted: str) -> str:
        """Wait until the driver has told the adapter `wanted` (a command or a frame); what it told before that."""
        links.eventually(lambda: wanted + "\r" in self._text, f"the adapter is told {wanted!r}")
        with self._text_lock:
            before, _, self._text = self._text.partition(wanted + "\r")
        return before

    def close(self) -> None:
        """Unplug."""
        if self._open:
            self._open = False
            self._reader.join()
            os.close(self._line)
            os.close(self._adapter)
