"""A process on a local bus, for tests: says hello, then does one thing until it is told to stop or killed.

    python -m tests.support.local_member CHANNEL echo|count

echo: answers every frame on 0x100 with the same data on 0x200. count: only reads. 0x7ff tells either to stop; it then
prints how many frames it has received and lost.
"""

import select
import sys
import time

from drivers.bus.port import open_port
from drivers.config import BusConfig
from drivers.frame import Frame

HELLO, PING, PONG, STOP = 0x700, 0x100, 0x200, 0x7FF


def main(channel: str, manner: str) -> None:
    port = open_port(BusConfig(interface="local", channel=channel, receive_limit=32), role="host", fd=False)
    port.drain(time.monotonic_ns())  # a port counts what it has lost since its first read
    port.send(Frame(HELLO, b""))
    waiting = select.poll()
    waiting.register(port.fileno(), select.POLLIN)
    while True:
        waiting.poll()
        for frame in port.drain(time.monotonic_ns()):
            if frame.can_id == PING and manner == "echo":
                port.send(Frame(PONG, frame.data))
            elif frame.can_id == STOP:
                print(port.counters().received, port.counters().overflow)
                return


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2])
