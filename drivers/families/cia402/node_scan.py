"""Who is on a CANopen bus: every node number is asked for its device type (1000h), those that answer who they are.

At most one frame a call, as a bus with a running drive has room for it. Nothing is written to any node.
"""

from collections import deque
from dataclasses import dataclass

from drivers.families.cia402 import cia301
from drivers.families.cia402.cia301 import Abort
from drivers.families.cia402.sdo import LONGEST_STRING, Progress, Step, Transfer
from drivers.frame import Frame

LAST_NODE = 127
_GRACE_TICKS = 50  # for the answer of the last node asked
_TIMEOUT_TICKS = 100
_IDENTITY = {(0x1018, 1): "vendor", (0x1018, 2): "product", (0x1018, 3): "revision", (0x1018, 4): "serial"}
_NAME = (0x1008, 0)
_REGISTER = (0x1001, 0)


@dataclass
class NodeIdentity:
    """What a node says it is; None where it does not. device_type: 1000h. name: 1008h. vendor, product, revision,
    serial: 1018h. error_register: 1001h.
    """

    node_id: int
    device_type: int | None = None
    name: str = ""
    vendor: int | None = None
    product: int | None = None
    revision: int | None = None
    serial: int | None = None
    error_register: int | None = None


class NodeScan:
    """One scan. found: the nodes that answered, by number. done: all have been asked, and all answers are in."""

    def __init__(self, own: int) -> None:
        """own: the master's node number, which is not asked."""
        self.found: dict[int, NodeIdentity] = {}
        self._to_ask = deque(node for node in range(1, LAST_NODE + 1) if node != own)
        self._to_read: deque[tuple[int, Step]] = deque()
        self._node = 0
        self._transfer: Transfer | None = None
        self._request_due = False
        self._closing = b""
        self._waited = 0
        self.done = False

    def service(self) -> Frame | None:
        """The next frame to send, if any; once a tick."""
        if self._to_ask:
            node = self._to_ask.popleft()
            return Frame(cia301.SDO_REQUEST_ID + node, Transfer(Step(0x1000, 0, 0)).request())
        if self._closing:
            closing, self._closing = self._closing, b""
            return Frame(cia301.SDO_REQUEST_ID + self._node, closing)
        self._waited += 1
        if self._transfer is None:
            if self._to_read:
                self._node, step = self._to_read.popleft()
                self._transfer, self._request_due = Transfer(step, LONGEST_STRING), True
            else:
                self.done = self._waited > _GRACE_TICKS
                return None
        elif self._waited > _TIMEOUT_TICKS:
            frame = Frame(cia301.SDO_REQUEST_ID + self._node, self._transfer.abort(Abort.TIMEOUT))
            self._transfer = None
            return frame
        if not self._request_due:
            return None
        self._request_due, self._waited = False, 0
        return Frame(cia301.SDO_REQUEST_ID + self._node, self._transfer.request())

    def on_frame(self, frame: Frame) -> None:
        """Any received frame; those that are no SDO answers are passed over."""
        node = frame.can_id - cia301.SDO_RESPONSE_ID
        if not 1 <= node <= LAST_NODE or frame.flags or len(frame.data) != 8:
            return
        if node not in self.found:
            self._note_found(node, frame.data)
        elif self._transfer is not None and node == self._node:
            self._note_answer(self._transfer, frame.data)

    def _note_found(self, node: int, data: bytes) -> None:
        transfer = Transfer(Step(0x1000, 0, 0))
        progress = transfer.answer(data)
        if progress is Progress.FOREIGN:
            return
        identity = self.found[node] = NodeIdentity(node)
        if progress is Progress.DONE:
            identity.device_type = transfer.value
        objects = (*_IDENTITY, _NAME, _REGISTER)
        self._to_read.extend((node, Step(*place, 0, width=1 if place == _REGISTER else 4)) for place in objects)

    def _note_answer(self, transfer: Transfer, data: bytes) -> None:
        progress = transfer.answer(data)
        if progress is Progress.CONTINUE:
            self._request_due = True
        elif progress is not Progress.FOREIGN:
            if progress is Progress.DONE:
                self._keep(transfer)
            self._transfer, self._waited, self._closing = None, 0, transfer.closing

    def _keep(self, transfer: Transfer) -> None:
        identity = self.found[self._node]
        place = transfer.step.object_index, transfer.step.subindex
        if place == _NAME:
            identity.name = transfer.data.rstrip(b"\0").decode("latin-1")
        elif place == _REGISTER:
            identity.error_register = transfer.value
        else:
            setattr(identity, _IDENTITY[place], transfer.value)
