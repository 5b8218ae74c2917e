"""The frame of a rig's outputs, sent in every tick behind the drives' command.

| bytes | content |
|---|---|
| 0 | bit i: output i is set |
| 1 | the same, inverted: what no node obeys where it does not fit |
| 2 | sequence, one more with every frame, modulo 256 |

A node sets all its outputs to 0 at its start and 10 ms after the last such frame.
"""

from typing import Final

from drivers.frame import Frame

LENGTH: Final = 3


def output_frame(can_id: int, bits: int, sequence: int) -> Frame:
    """bits: 0 to 255. sequence: counted by the sender, modulo 256."""
    return Frame(can_id, bytes((bits & 0xFF, ~bits & 0xFF, sequence & 0xFF)))
