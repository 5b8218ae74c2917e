"""Does the frame-length model that bus load and schedulability rest on agree with can-utils' own?"""

import random
import subprocess
from collections.abc import Callable

import pytest

from drivers.frame import EXTENDED, Frame
from drivers.frame_length import frame_bits
from tests.vm import links
from tests.vm.ports import port_on

pytestmark = pytest.mark.vcan

INTERMISSION = 3


def canbusload_total(channel: str, send: Callable[[], None], frames: int) -> int:
    """Exact bits that canbusload counts for `frames` frames that `send` sends."""
    before = links.listeners(channel)
    with subprocess.Popen(["canbusload", "-e", f"{channel}@1000000"], stdout=subprocess.PIPE, text=True) as process:
        try:
            links.eventually(lambda: links.listeners(channel) > before, "canbusload listens")
            send()
            seen = bits = 0
            assert process.stdout is not None
            for line in process.stdout:
                if line.strip().startswith(f"{channel}@"):
                    _, count, total, *_ = line.split()
                    seen, bits = seen + int(count), bits + int(total)
                if seen >= frames:
                    break
        finally:
            process.terminate()
    assert seen == frames
    return bits


def test_exact_lengths_agree_with_canbusload(vcan: str) -> None:
    source = random.Random(7)
    traffic = [
        Frame(
            source.getrandbits(29) | EXTENDED if index % 3 == 0 else source.getrandbits(11),
            bytes(source.choice((0x00, 0xFF, source.getrandbits(8))) for _ in range(source.randrange(9))),
        )
        for index in range(200)
    ]
    host = port_on(vcan)

    def send() -> None:
        for frame in traffic:
            assert host.send(frame)

    expected = sum(frame_bits(frame)[0] + INTERMISSION for frame in traffic)
    assert canbusload_total(vcan, send, len(traffic)) == expected
    host.close()
