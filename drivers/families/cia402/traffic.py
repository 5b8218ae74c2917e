"""What a bus of CiA 402 drives carries, for the schedulability analysis."""

from collections.abc import Sequence

from drivers.families.cia402 import cia301
from drivers.families.cia402.drive_plan import DrivePlan
from drivers.families.cia402.inputs import LENGTH as INPUTS_LENGTH
from drivers.families.cia402.inputs import TPDO2_ID
from drivers.families.cia402.master import SERVICE_TICKS
from drivers.families.cia402.profile import DRIVE_HEARTBEAT_MS
from drivers.families.cia402.touch_probe import LENGTH as PROBE_LENGTH
from drivers.families.cia402.touch_probe import SYNCS, TPDO3_ID
from drivers.protocols.base import Message


def cia402_messages(nodes: Sequence[int], plans: Sequence[DrivePlan], period_ns: int) -> list[Message]:
    """Traffic of CiA 402 drives for the schedulability analysis, as it results from their plans."""

    def cyclic(name: str, can_id: int, length: int, sender: str = "host", after: str | None = None) -> Message:
        return Message(name, can_id, length, False, period_ns, period_ns, 0, sender, after)

    rare_ns = SYNCS * period_ns
    if plans[0].shared:
        commands = [cyclic("torques", cia301.RPDO1_ID + nodes[0], 2 * len(nodes))]
    else:
        commands = [cyclic(f"command {axis}", cia301.RPDO1_ID + node, 4) for axis, node in enumerate(nodes)]
    return [
        *commands,
        cyclic("sync", cia301.SYNC_ID, int(plans[0].counter)),
        *(
            cyclic(f"feedback {a}", cia301.TPDO1_ID + node, plans[a].answer_length, f"axis {a}", "sync")
            for a, node in enumerate(nodes)
        ),
        *(
            cyclic(f"inputs {a}", TPDO2_ID + node, INPUTS_LENGTH, f"axis {a}", "sync")
            for a, node in enumerate(nodes)
            if plans[a].inputs
        ),
        *(
            Message(f"probe {a}", TPDO3_ID + node, PROBE_LENGTH, False, rare_ns, rare_ns, period_ns, f"axis {a}")
            for a, node in enumerate(nodes)
            if plans[a].probe
        ),
        *service_messages(nodes, [plan.emcy_id for plan in plans], period_ns),
    ]


def service_messages(nodes: Sequence[int], emcy_ids: Sequence[int], period_ns: int) -> list[Message]:
    """What the master may send at most (an SDO request, or in its place a controlword or heartbeat) and its answer; the
    drives' heartbeats, and emergencies at the rate of heartbeats."""
    last = max(nodes)
    service_ns = SERVICE_TICKS * period_ns
    slow = DRIVE_HEARTBEAT_MS * 1_000_000
    sender = f"axis {nodes.index(last)}"
    return [
        Message("service", cia301.SDO_REQUEST_ID + last, 8, False, service_ns, service_ns, 0, "host"),
        Message("answer", cia301.SDO_RESPONSE_ID + last, 8, False, service_ns, slow, 0, sender, "service"),
        *(
            Message(f"emergency {a}", can_id, 8, False, slow, slow, 0, f"axis {a}")
            for a, can_id in enumerate(emcy_ids)
            if can_id
        ),
        *(
            Message(f"heartbeat {a}", cia301.HEARTBEAT_ID + node, 1, False, slow, slow, 0, f"axis {a}")
            for a, node in enumerate(nodes)
        ),
    ]
