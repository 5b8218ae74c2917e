"""`make bench ARGS=peers`: the whole live tick against what other Python stacks need for a part of it.

- python-can + cantools: receive four Messages, decode them, encode one, send it, on the same local bus against the same
  emulated stage. No filter, no law, no checks.
- canopen: four TPDOs received and decoded, four RPDOs and SYNC sent, through its Network, on a local bus.
- LinuxCNC, where it is installed: its real-time thread with four PIDs and no bus at all (linuxcnc.py).
- moteus: one `Transport.cycle` of four controllers over a stub device, so no I/O at all.

Every subject gets the same core, priority and memory lock, and is paced at 1 kHz, so that its caches are cold. Figures
are CPU time of the whole process per period, sleep and wake included: canopen receives in a thread of its own. All
sleep to the deadline; what being woken ahead of it costs our loop besides is shown, and compared with nothing.
"""

import asyncio
import contextlib
import importlib.util
import os
import select
import struct
import time
from collections.abc import Awaitable, Callable, Iterator
from functools import partial
from multiprocessing import get_context
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Annotated, Any
from zlib import crc32

import numpy as np
import typer

from drivers.bus.port import open_port
from drivers.config import BusConfig
from drivers.frame import Frame
from hil.cli.options import Overrides, RigFile
from hil.live.pacing import Pacer
from hil.live.realtime import claim
from hil.operate.bench.blocks import (
    Case,
    Figures,
    JsonTarget,
    as_json,
    block_table,
    interleave,
    percentiles,
    publish,
    ratios,
    spread,
)
from hil.operate.bench.live_runs import TO_THE_DEADLINE, BenchError, bench_bus, cores, emulator, run_control
from hil.rig.schema import TimingConfig
from sim_plant.process import promote
from tests.benchmarks import linuxcnc

PERIOD_NS = 1_000_000
WARM_UP = 300
AXES = 4
SYNC, STATUS = 0x080, 0x1237
CANOPEN_CHANNEL = "bench1"
OURS, AHEAD = "hil run, all of it", "hil run, woken ahead"
PYTHON_CAN, CANOPEN, MOTEUS = "python-can + cantools", "canopen", "moteus, no I/O"
LINUXCNC = "LinuxCNC's servo thread, no bus"

Tick = Callable[[int], Awaitable[int]]  # number of the tick -> answers understood


def peers(
    rig: RigFile = Path("microscope-ideal"),
    overrides: Overrides = None,
    blocks: Annotated[int, typer.Option(min=1)] = 5,
    ticks: Annotated[int, typer.Option(min=100, help="measured ticks per block")] = 3000,
    as_json_to: JsonTarget = None,
) -> None:
    """The whole tick against python-can + cantools, canopen and moteus."""
    if importlib.util.find_spec("moteus") is None:
        raise SystemExit("bench peers: moteus is not installed: pip install 'hil[bench]'")
    sets = overrides or []
    cases = [
        Case(OURS, partial(_ours, rig, [*sets, TO_THE_DEADLINE], ticks)),
        Case(AHEAD, partial(_ours, rig, sets, ticks)),
        Case(PYTHON_CAN, partial(_beside_emulator, rig, sets, ticks)),
        Case(CANOPEN, partial(in_child, "canopen", ticks)),
        Case(MOTEUS, partial(in_child, "moteus", ticks)),
    ]
    others = [PYTHON_CAN, CANOPEN, MOTEUS]
    if linuxcnc.installed():
        cases.append(Case(LINUXCNC, partial(linuxcnc.servo_thread, ticks)))
        others.append(LINUXCNC)
    with bench_bus("bench peers"):
        measured = interleave(cases, blocks)
    against = {case: spread(ratios(measured, OURS, case, "p50")) for case in others}
    result = {"ratio_p50": {case: r._asdict() for case, r in against.items()}, "blocks": as_json(measured)}
    lines = [f"hil's whole tick / {case}: {ratio.median:.2f}" for case, ratio in against.items()]
    if not linuxcnc.installed():
        lines.append(f"{LINUXCNC}: not run, as it is not installed (Debian: apt install linuxcnc-uspace)")
    table = block_table(
        "CPU per tick, and the worst period's distance from 1 ms, us", measured, ["p50", "p99", "worst_period"]
    )
    publish(result, [table], as_json_to, lines)


def _ours(rig: Path, sets: list[str], ticks: int) -> Figures:
    run = run_control(rig, sets, ticks)
    cpu = {name: run.timing.quantile("cpu", fraction) / 1e3 for name, fraction in (("p50", 0.5), ("p99", 0.99))}
    return {**cpu, "worst_period": float(np.abs(np.diff(run.lateness)).max()) / 1e3}


def _beside_emulator(rig: Path, sets: list[str], ticks: int) -> Figures:
    with emulator(rig, sets):
        return in_child("python-can", ticks)


def in_child(peer: str, ticks: int) -> Figures:
    """One block of a peer in a fresh interpreter."""
    context = get_context("spawn")
    ours, theirs = context.Pipe(duplex=False)
    child = context.Process(target=_measure, args=(peer, ticks, theirs))
    child.start()
    theirs.close()
    try:
        answer: Figures | str = ours.recv()
    except EOFError:
        answer = "ended without an answer"
    child.join()
    if isinstance(answer, str):
        raise BenchError(f"{peer}: {answer}")
    return answer


def _measure(peer: str, ticks: int, answer: Connection) -> None:
    with PEERS[peer]() as tick:
        held = claim(TimingConfig())
        spent, understood = asyncio.run(_paced(tick, ticks))
        held.close()
    if understood < 0.9 * AXES * ticks:
        answer.send(f"understood only {understood} of {AXES * ticks} answers")
    else:
        answer.send(percentiles(spent / 1e3))


async def _paced(tick: Tick, ticks: int) -> tuple[Any, int]:
    spent, understood = np.zeros(ticks), 0
    pacer = Pacer(PERIOD_NS)
    pacer.start()
    mark = 0
    for index in range(ticks + WARM_UP):
        pacer.wait()
        count = await tick(index)
        now = time.process_time_ns()
        if index >= WARM_UP:
            spent[index - WARM_UP] = now - mark
            understood += count
        mark = now
    return spent, understood


@contextlib.contextmanager
def python_can() -> Iterator[Tick]:
    """python-can and cantools as their documentation shows them."""
    import can
    import cantools

    from drivers.families.stage.stage_fd import DBC

    database: Any = cantools.database.load_file(DBC)
    layout = database.get_message_by_name("Command")
    with can.Bus(interface="local", channel="can0", fd=True) as bus:

        async def tick(index: int) -> int:
            positions = {}
            while (message := bus.recv(timeout=0)) is not None:
                positions[message.arbitration_id] = database.decode_message(message.arbitration_id, message.data)
            values = {f"force_{axis}": 0.0 for axis in range(AXES)}
            values |= {"sequence": index % 65536, "flags": 0, "checksum": 0}
            data = layout.encode(values)
            data = data[:-4] + crc32(data[:-4], layout.frame_id).to_bytes(4, "little")
            message = can.Message(
                arbitration_id=layout.frame_id, data=data, is_extended_id=False, is_fd=True, bitrate_switch=True
            )
            with contextlib.suppress(can.CanOperationError):  # full: the stage was held up, its answers are missing
                bus.send(message)
            return len(positions)

        yield tick


@contextlib.contextmanager
def canopen_pdos() -> Iterator[Tick]:
    """canopen's own network and PDO classes; drives that answer SYNC at once, in a process of their own."""
    import can
    import canopen

    from drivers.families.cia402.cia301 import EDS

    context = get_context("spawn")
    ready = context.Event()
    drives = context.Process(target=_answer_sync, args=(ready,), daemon=True)
    drives.start()
    ready.wait()
    network = canopen.Network()
    nodes: list[Any] = []
    for number in range(1, AXES + 1):
        node = canopen.RemoteNode(number, str(EDS))
        network.add_node(node)
        _map(node.tpdo[1], 0x180 + number, 0x6064, 0x6041)
        _map(node.rpdo[1], 0x200 + number, 0x6071)
        node.tpdo[1].subscribe()
        nodes.append(node)
    network.connect(interface="local", channel=CANOPEN_CHANNEL)

    def send(index: int) -> None:
        for node in nodes:
            node.rpdo[1][0].raw = index % 100
            node.rpdo[1].transmit()
        network.sync.transmit()

    async def tick(index: int) -> int:
        feedback = [(node.tpdo[1][0].raw, node.tpdo[1][1].raw) for node in nodes]
        with contextlib.suppress(can.CanOperationError):  # full: the drives were held up, their answers are missing
            send(index)
        return sum(position > 0 and status == STATUS for position, status in feedback)

    try:
        yield tick
    finally:
        network.disconnect()
        drives.terminate()
        drives.join()


def _answer_sync(ready: Any) -> None:
    """Four drives: a TPDO each for every SYNC."""
    os.sched_setaffinity(0, {cores()[0]})
    promote()  # as `hil emulate` does: else a busy neighbour fills the queues
    bus = BusConfig(interface="local", channel=CANOPEN_CHANNEL, protocol="cia402", receive_limit=32)
    port = open_port(bus, role="device", fd=False)
    poll = select.poll()
    poll.register(port.fileno(), select.POLLIN)
    ready.set()
    count = 0
    while True:
        poll.poll()
        for frame in port.drain(time.monotonic_ns()):
            if frame.can_id == SYNC:
                count += 1
                for number in range(1, AXES + 1):
                    port.send(Frame(0x180 + number, struct.pack("<iH", count, STATUS)))


def _map(pdo: Any, cob_id: int, *objects: int) -> None:
    pdo.clear()
    pdo.cob_id = cob_id
    pdo.enabled = True
    for index in objects:
        pdo.add_variable(index)


@contextlib.contextmanager
def moteus_cycle() -> Iterator[Tick]:
    """moteus' Transport over a device that answers from memory."""
    import moteus
    from moteus.transport_device import Frame, TransportDevice

    answer = b"\x21\x00\x0a" + b"\x2f\x01" + struct.pack("<fff", 0.25, 0.1, 0.02) + b"\x23\x0d\x30\x19\x00"

    class Memory(TransportDevice):  # type: ignore[misc]
        def empty_bus_tx_safe(self) -> bool:
            return True

        async def send_frame(self, frame: Any) -> None:
            pass

        async def transaction(self, requests: list[Any], **_: object) -> None:
            for request in requests:
                number = request.frame.arbitration_id & 0x7F
                request.responses.append(Frame(arbitration_id=number << 8, data=answer, dlc=len(answer), is_fd=True))

    transport = moteus.Transport([Memory()])
    controllers = [moteus.Controller(id=number, transport=transport) for number in range(1, AXES + 1)]

    async def tick(index: int) -> int:
        commands = [
            c.make_position(position=0.1, velocity=0.0, feedforward_torque=0.01, query=True) for c in controllers
        ]
        results = await transport.cycle(commands)
        return sum(result.values[moteus.Register.POSITION] == 0.25 for result in results)

    yield tick


PEERS: dict[str, Callable[[], contextlib.AbstractContextManager[Tick]]] = {
    "python-can": python_can,
    "canopen": canopen_pdos,
    "moteus": moteus_cycle,
}
