"""What a CAN port counts; the same for a socket, the local bus and the simulated wire."""

from collections.abc import Sequence
from enum import IntEnum
from typing import NamedTuple


class BusState(IntEnum):
    """The controller's fault-confinement state (ISO 11898-1, 13.1)."""

    ERROR_ACTIVE = 0
    ERROR_PASSIVE = 1
    BUS_OFF = 2
    DOWN = 3  # interface gone or down


class PortCounters(NamedTuple):
    """Cumulative counters of a CAN port since it was opened."""

    received: int = 0
    sent: int = 0
    refused: int = 0  # ENOBUFS, EAGAIN: the transmit queue was full
    overflow: int = 0  # frames the kernel dropped for want of receive buffer (SO_RXQ_OVFL)
    discarded: int = 0  # frames beyond the tick's receive limit (flood): counted, oldest dropped
    errors: int = 0  # error frames
    no_ack: int = 0
    bus_off: int = 0
    restarted: int = 0
    down: int = 0  # ENETDOWN, ENODEV
    echo: int = 0  # own frames seen again
    state: BusState = BusState.ERROR_ACTIVE


def of_all(counters: Sequence[PortCounters]) -> PortCounters:
    """The counters of several segments as those of one bus: their sums, and the worst of their states."""
    sums = [sum(counts) for counts in zip(*(of_one[:-1] for of_one in counters), strict=True)]
    return PortCounters._make([*sums, max(of_one.state for of_one in counters)])
