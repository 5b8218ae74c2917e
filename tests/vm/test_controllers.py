"""Two emulated SJA1000 controllers behind their real driver on one bus: can0 is the host's, can1 the stage's."""

import configparser
import contextlib
import os
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from drivers.bus.port import BusState
from drivers.frame import Frame
from hil.cycle.state_machine import State
from hil.operate.install import network_files
from hil.rig.file import load_rig
from tests.vm import links
from tests.vm.live import RIGS, UNHURRIED, assert_closed_loop, live_rig
from tests.vm.ports import drained_until, port_on, receive

pytestmark = pytest.mark.controller

NETWORK = Path(__file__).parents[2] / "deploy/systemd/network"
STAGE_NAMESPACE = "hilstage"
CLASSIC = ("bus.protocol=stage_classic", "bus.bitrate=500000", "bus.transmit_queue=4")


def deployed() -> configparser.SectionProxy:
    """[CAN] of the classic network file that `hil install` puts in place."""
    parser = configparser.ConfigParser(strict=False)
    parser.read(NETWORK / "can-classic.network")
    return parser["CAN"]


def installed(channel: str) -> dict[str, str]:
    """Bit rate and transmit queue that `hil install` would configure for the paper's rig on this channel."""
    rig = load_rig(RIGS / "paper.toml", [*CLASSIC, f"bus.channel={channel}"])
    parser = configparser.ConfigParser(strict=False)
    for text in network_files(rig.bus, fd=False).values():
        parser.read_string(text)
    assert parser["Match"]["Name"] == parser["Match"]["OriginalName"] == channel
    return {**parser["CAN"], **parser["Link"]}


@pytest.fixture
def pair() -> Iterator[tuple[str, str]]:
    """can0 and can1, up, as deployed."""
    links.run("modprobe", "kvaser_pci")
    names = ("can0", "can1")
    for name in names:
        assert links.exists(name), "the lane boots with two controllers"
        links.ip("link", "set", name, "up", "type", "can", "bitrate", deployed()["BitRate"])
    yield names
    for name in names:
        links.ip("link", "set", name, "down")


@pytest.fixture
def stage_elsewhere(pair: tuple[str, str]) -> Iterator[str]:
    """can1 moved into a network namespace of its own, where the host's processes cannot reach it but over the bus."""
    links.ip("link", "set", "can1", "down")
    links.ip("netns", "add", STAGE_NAMESPACE)
    links.ip("link", "set", "can1", "netns", STAGE_NAMESPACE)
    inside = ("-n", STAGE_NAMESPACE, "link", "set", "can1")
    links.ip(*inside, "up", "type", "can", "bitrate", deployed()["BitRate"])
    yield STAGE_NAMESPACE
    links.ip(*inside, "down")
    links.ip(*inside, "netns", "1")
    links.ip("netns", "delete", STAGE_NAMESPACE)
    links.ip("link", "set", "can1", "up", "type", "can", "bitrate", deployed()["BitRate"])


def test_the_controller_runs_at_the_deployed_bit_rate_and_stays_off_after_bus_off(pair: tuple[str, str]) -> None:
    assert "RestartSec" not in deployed()
    for name in pair:
        info = links.details(name)["linkinfo"]["info_data"]
        assert info["bittiming"]["bitrate"] == int(deployed()["BitRate"])
        assert info.get("restart_ms", 0) == 0, "the kernel must not bring a controller back by itself"
        assert info["state"] == "ERROR-ACTIVE"
        assert info["berr_counter"] == {"tx": 0, "rx": 0}


def test_frames_cross_the_emulated_bus_in_both_directions_in_order(pair: tuple[str, str]) -> None:
    host, stage = (port_on(name, fd=False) for name in pair)
    for number in range(20):
        assert host.send(Frame(0x080, bytes([number] * 8)))
        assert stage.send(Frame(0x100, bytes([number])))
        assert receive(stage, 1)[0].data == bytes([number] * 8)
        assert receive(host, 1)[0].data == bytes([number])
    counters = host.counters()
    assert (counters.sent, counters.received, counters.errors, counters.refused) == (20, 20, 0, 0)
    host.close()
    stage.close()


def test_the_driver_does_not_echo_our_own_frames_to_us(pair: tuple[str, str]) -> None:
    host, stage = (port_on(name, fd=False) for name in pair)
    host.send(Frame(0x080, b"torque"))
    receive(stage, 1)
    stage.send(Frame(0x100, b"sample"))
    assert [frame.can_id for frame in receive(host, 1)] == [0x100]
    host.close()
    stage.close()


def test_a_controller_taken_down_is_seen_and_comes_back_by_rebind(pair: tuple[str, str]) -> None:
    host, stage = (port_on(name, fd=False) for name in pair)
    links.ip("link", "set", "can0", "down")
    drained_until(host, lambda: host.counters().state is BusState.DOWN, "the host sees it")
    assert host.rebind() is False
    links.ip("link", "set", "can0", "up")
    assert host.rebind() is True
    assert host.send(Frame(0x080, b"\x01"))
    assert receive(stage, 1)[0].data == b"\x01"
    host.close()
    stage.close()


def test_a_stage_in_another_network_namespace_is_reached_over_the_bus_alone(stage_elsewhere: str) -> None:
    assert not links.exists("can1")
    host = port_on("can0", fd=False)
    command = ["ip", "netns", "exec", stage_elsewhere, "candump", "-L", "-n", "1", "can1"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as stage:
        # candump cannot be asked from here whether it listens: repeat until it has heard one
        links.eventually(lambda: (host.send(Frame(0x080, b"\x2a")), stage.poll())[1] is not None, "the stage hears")
        assert stage.stdout is not None
        assert stage.stdout.read().split()[2] == "080#2A"
    links.ip("netns", "exec", stage_elsewhere, "cansend", "can1", "100#BEEF")
    assert receive(host, 1)[0][:2] == (0x100, b"\xbe\xef")
    host.close()


def test_the_whole_loop_runs_over_two_controllers_as_installed(stage_elsewhere: str) -> None:
    """Host and stage in different network namespaces, at the bit rate and with the queue that `hil install` writes."""
    wanted = installed("can0")
    links.ip("link", "set", "can0", "down")
    links.ip("-n", stage_elsewhere, "link", "set", "can1", "down")
    links.ip("link", "set", "can0", "txqueuelen", wanted["transmitqueuelength"])
    links.ip("link", "set", "can0", "up", "type", "can", "bitrate", wanted["bitrate"])
    links.ip("-n", stage_elsewhere, "link", "set", "can1", "up", "type", "can", "bitrate", wanted["bitrate"])
    found = links.details("can0")
    assert (found["linkinfo"]["info_data"]["bittiming"]["bitrate"], found["txqlen"]) == (500_000, 4)

    prefix = ("ip", "netns", "exec", stage_elsewhere)
    with live_rig("can0", *CLASSIC, *UNHURRIED, stage_prefix=prefix, stage_channel="can1") as rig:
        assert_closed_loop(rig)
        rig.activate()
        links.ip("link", "set", "can0", "down")
        rig.wait_for(State.FAULT)
        links.ip("link", "set", "can0", "up")
        rig.to_ready()
        assert_closed_loop(rig)
        assert rig.stop() == 0
        assert rig.applied_forces() == [0.0, 0.0]


@contextlib.contextmanager
def before_the_drivers_interrupts(name: str) -> Iterator[None]:
    """For the length of the block this thread runs, and the threads that serve the interface's interrupts do not.

    With PREEMPT_RT these are FIFO 50 and follow the interrupt's CPU: we take the same CPU at FIFO 90.
    """
    numbers = [line.split(":")[0].strip() for line in Path("/proc/interrupts").read_text().splitlines() if name in line]
    assert numbers, f"{name} has an interrupt"
    masks = {Path(f"/proc/irq/{number}/smp_affinity"): "" for number in numbers}
    cpus = os.sched_getaffinity(0)
    for path in masks:
        masks[path] = path.read_text()
        path.write_text("1")
    links.run("cangen", name, "-n", "5", "-g", "1")  # interrupts and their threads move with the next ones
    os.sched_setaffinity(0, {0})
    os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(90))
    try:
        yield
    finally:
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
        os.sched_setaffinity(0, cpus)
        for path, mask in masks.items():
            path.write_text(mask)


def test_a_transmit_queue_of_one_refuses_the_rest_of_a_burst_and_loses_nothing_it_took(pair: tuple[str, str]) -> None:
    links.ip("link", "set", "can0", "down")
    links.ip("link", "set", "can0", "txqueuelen", "1", "up")
    host, stage = (port_on(name, fd=False) for name in pair)
    with before_the_drivers_interrupts("can0"):
        stage.drain(time.monotonic_ns())
        taken = [number for number in range(20) if host.send(Frame(0x080, bytes([number])))]
    assert 1 <= len(taken) < 20, "one frame in the controller, one in the queue"
    assert host.counters().refused == 20 - len(taken)
    assert [frame.data[0] for frame in receive(stage, len(taken))] == taken
    assert host.send(Frame(0x081, b"next")), "the queue is free again"
    assert receive(stage, 1)[0].can_id == 0x081
    host.close()
    stage.close()
    links.ip("link", "set", "can0", "down")
    links.ip("link", "set", "can0", "txqueuelen", "10", "up")
