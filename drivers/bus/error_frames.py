"""SocketCAN error frames (include/uapi/linux/can/error.h): what a controller's driver says about its bus."""

from typing import NamedTuple

from drivers.bus.counters import BusState
from drivers.frame import ERROR, Frame

# classes, in the identifier
TX_TIMEOUT = 0x001
ARBITRATION_LOST = 0x002
CONTROLLER = 0x004
PROTOCOL = 0x008
TRANSCEIVER = 0x010
NO_ACK = 0x020
BUS_OFF = 0x040
BUS_ERROR = 0x080
RESTARTED = 0x100
COUNTERS = 0x200

# CONTROLLER: data[1]
RX_OVERFLOW = 0x01
TX_OVERFLOW = 0x02
RX_WARNING = 0x04
TX_WARNING = 0x08
RX_PASSIVE = 0x10
TX_PASSIVE = 0x20
ACTIVE = 0x40

_LOCATION_ACK_SLOT = 0x19  # PROTOCOL: data[3]; how the SJA1000 family reports a missing acknowledgement
_LENGTH = 8  # CAN_ERR_DLC

_CLASSES = {
    TX_TIMEOUT: "transmit timeout",
    ARBITRATION_LOST: "arbitration lost",
    PROTOCOL: "protocol violation",
    TRANSCEIVER: "transceiver",
    NO_ACK: "no acknowledgement",
    BUS_OFF: "bus off",
    BUS_ERROR: "bus error",
    RESTARTED: "restarted",
}
_CONTROLLER = {
    RX_OVERFLOW: "receive overflow",
    TX_OVERFLOW: "transmit overflow",
    RX_WARNING: "receive warning",
    TX_WARNING: "transmit warning",
    RX_PASSIVE: "receive passive",
    TX_PASSIVE: "transmit passive",
    ACTIVE: "error active",
}


class ErrorReport(NamedTuple):
    """What one error frame says.

    state: the controller's new fault-confinement state, None where the frame does not tell. overflow: frames that this
    node lost for want of buffer; a controller says only that there were some, which counts as one.
    """

    state: BusState | None
    no_ack: bool
    bus_off: bool
    restarted: bool
    overflow: int


def decode_error(can_id: int, data: bytes) -> ErrorReport:
    """Read an error frame; `data` may be of any length, as it comes from outside."""
    padded = data[:_LENGTH].ljust(_LENGTH, b"\0")
    bus_off = bool(can_id & BUS_OFF)
    restarted = bool(can_id & RESTARTED)
    controller = padded[1] if can_id & CONTROLLER else 0
    acknowledge_slot = bool(can_id & PROTOCOL) and padded[3] == _LOCATION_ACK_SLOT
    return ErrorReport(
        state=_state(bus_off, restarted, controller),
        no_ack=bool(can_id & NO_ACK) or acknowledge_slot,
        bus_off=bus_off,
        restarted=restarted,
        overflow=max(1, padded[5]) if controller & RX_OVERFLOW else 0,
    )


def _state(bus_off: bool, restarted: bool, controller: int) -> BusState | None:
    if bus_off:
        return BusState.BUS_OFF
    if controller & (RX_PASSIVE | TX_PASSIVE):
        return BusState.ERROR_PASSIVE
    if restarted or controller & (ACTIVE | RX_WARNING | TX_WARNING):  # a warning is given while still error-active
        return BusState.ERROR_ACTIVE
    return None


def overflow_notice(lost: int) -> Frame:
    """The error frame that tells a node that `lost` (1 to 255) frames did not fit into its receive buffer."""
    return Frame(ERROR | CONTROLLER, bytes((0, RX_OVERFLOW, 0, 0, 0, lost, 0, 0)))


def describe_error(can_id: int, data: bytes) -> str:
    """An error frame in words, for people."""
    padded = data[:_LENGTH].ljust(_LENGTH, b"\0")
    words = [text for bit, text in _CLASSES.items() if can_id & bit]
    if can_id & CONTROLLER:
        words += [text for bit, text in _CONTROLLER.items() if padded[1] & bit] or ["controller"]
    if can_id & COUNTERS:
        words.append(f"counters tx {padded[6]} rx {padded[7]}")
    return ", ".join(words) or "unspecified"
