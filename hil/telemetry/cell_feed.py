"""A client's view of a batch of cells: what is told from now on, and what was told before it joined."""

import zenoh
from google.protobuf.message import DecodeError
from zenoh.handlers import RingChannel

from hil.telemetry import telemetry_pb2 as pb
from hil.telemetry.backlog import Backlog

_KEPT = 200  # messages for a reader that is late


class CellFeed:
    """key: <key>/<rig>/cells."""

    def __init__(self, session: zenoh.Session, key: str) -> None:
        self._live = session.declare_subscriber(key, RingChannel(_KEPT))
        self._earlier = Backlog(session, key)

    def take(self) -> list[pb.Cell]:
        """What has come since the last call, the answer about earlier cells first. Never waits."""
        answers = self._earlier.take(wanted=not self._earlier.answered)
        found = [cell for sample in answers for cell in _cells(sample, pb.Cells)]
        while sample := self._live.try_recv():
            found += _cells(sample, pb.Cell)
        return found


def _cells(sample: zenoh.Sample, kind: type[pb.Cell] | type[pb.Cells]) -> list[pb.Cell]:
    try:
        message = kind.FromString(sample.payload.to_bytes())
    except DecodeError:  # of another version, or of anybody else who can publish there
        return []
    return [message] if isinstance(message, pb.Cell) else list(message.cells)
