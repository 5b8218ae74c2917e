"""A scale that sends its weight in 1/100 uN, big-endian, with a counter behind it."""

import hil


class Scale(hil.SensorFrame):
    """counts: per N."""

    def __init__(self, counts: float = 1e8) -> None:
        self.counts = counts

    def decode(self, data: bytes) -> hil.Measured | None:
        if len(data) != 5:
            return None
        return hil.Measured(int.from_bytes(data[:4], "big", signed=True) / self.counts, data[4])

    def encode(self, value: float, sequence: int, stamp_ns: int) -> bytes:
        return round(value * self.counts).to_bytes(4, "big", signed=True) + bytes((sequence,))
