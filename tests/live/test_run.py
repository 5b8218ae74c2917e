"""`hil run` as a process: how it starts, what it refuses, and that every end leaves the stage without torque."""

import os
import shutil
import signal
import socket
import time

import pytest

from drivers.protocols import device_protocol
from hil.cycle.state_machine import State
from hil.cycle.tick import CommandKind
from hil.live.ring import RingReader, previous_path
from hil.live.runtime_paths import runtime_paths
from hil.live.timing_record import read_timing
from tests.support.live_rig import PAPER, PATIENCE_S, Control, emulated, every_record, order, rig_with

pytestmark = pytest.mark.live
RIG_OK = 1 << 3
REALTIME_OK = 1 << 2


def decoded(emulator):
    """Every command the drives received until now, when they fall silent: (arrival ns, Command)."""
    emulator.stop()
    from drivers.frame import BRS, FD, Frame

    rig = rig_with()
    layout = device_protocol(rig.bus, 2, [a.rated_force for a in rig.axes.values()], PAPER.parent)
    frames = (Frame(rig.bus.host_id, data, FD | BRS, at) for at, data in emulator.commands)
    return [(frame.timestamp_ns, layout.decode_command(frame)) for frame in frames]


def complaints(err: str) -> list[str]:
    """What is on standard error beside the journal's lines of events."""
    return [line for line in err.splitlines() if not line.startswith("tick ")]


@pytest.mark.parametrize("end", [signal.SIGTERM, signal.SIGINT, signal.SIGHUP, CommandKind.SHUTDOWN])
def test_asked_to_end_while_active_it_stops_sends_zero_torque_last_and_exits_with_0(end):
    with emulated() as emulator, Control() as control:
        reader = control.wait_for(State.READY)
        order(CommandKind.ACTIVATE)
        control.wait_for(State.ACTIVE, reader)
        time.sleep(0.1)
        if isinstance(end, CommandKind):
            order(end)
        else:
            control.process.send_signal(end)
        status, out, err = control.finish()
        assert (status, complaints(err)) == (0, [])
        assert "ticks; lateness p50" in out
        _, last = decoded(emulator)[-1]
        assert (list(last.force), last.enable) == ([0.0, 0.0], 0)
        assert emulator.stage.applied_force == [0.0, 0.0]
    states = every_record()["state"]
    assert states[-1] == State.SHUTDOWN
    assert State.STOPPING in states
    with RingReader(runtime_paths("paper").ring) as ring:
        assert ring.ended


def test_with_terminal_and_runtime_directory_gone_it_stops_in_the_same_order_and_still_exits_with_0():
    with emulated() as emulator, Control() as control:
        reader = control.wait_for(State.READY)
        order(CommandKind.ACTIVATE)
        control.wait_for(State.ACTIVE, reader)
        control.process.stdout.close()
        control.process.stdout = None
        shutil.rmtree(runtime_paths("paper").directory)
        control.process.send_signal(signal.SIGHUP)
        assert control.process.wait(PATIENCE_S) == 0
        _, last = decoded(emulator)[-1]
        assert (list(last.force), last.enable) == ([0.0, 0.0], 0)


def test_a_process_that_was_told_to_ignore_the_hangup_outlives_its_terminal():
    ignore = "import signal; signal.signal(signal.SIGHUP, signal.SIG_IGN)"
    with emulated(), Control(wrap=ignore) as control:
        reader = control.wait_for(State.READY)
        control.process.send_signal(signal.SIGHUP)
        time.sleep(0.1)  # a stop would be over by then; then there is nobody to become ACTIVE
        order(CommandKind.ACTIVATE)
        control.wait_for(State.ACTIVE, reader)
        control.process.terminate()
        assert control.finish()[0] == 0


def test_a_run_of_n_ticks_leaves_n_records_and_a_timing_file():
    with emulated(), Control("--ticks", "300") as control:
        status, _, err = control.finish()
    assert (status, complaints(err)) == (0, [])
    records = every_record()
    assert len(records) == 301  # the stop asked for after 300 is carried out in the one after
    assert (records["cpu_ns"][5:].sum(axis=1) > 0).all()
    assert (records["index"][1:] > records["index"][:-1]).all()
    timing = read_timing(runtime_paths("paper").timing)
    assert timing.counters["ticks"] == 301
    assert timing.counters["missed_own"] + timing.counters["missed_host"] == records["index"][-1] - 300
    assert timing.quantile("cpu", 0.5) > 0
    assert timing.quantile("age", 0.5) > 0
    assert timing.counters["collector_runs"] == 0


@pytest.mark.requirement(id="SR-5.5")
def test_an_invalid_rig_is_refused_with_every_problem_before_any_bus(tmp_path, private_runtime_dir):
    rig = tmp_path / "bad.toml"
    rig.write_text(PAPER.read_text().replace("rate_hz = 1000", "rate_hz = -5\nwarp = 9"))
    with Control(rig=rig) as control:
        control.process.wait(PATIENCE_S)
    with Control("--set", "law.gains=7", "--set", "task.radius=nan", rig=PAPER) as control:
        status, out, err = control.finish()
    assert status == 78
    assert out == ""
    assert "law.gains" in err
    assert "task.radius" in err
    assert control.process.returncode == 78
    assert not list(private_runtime_dir.iterdir())


def test_a_missing_dbc_file_is_a_rig_problem():
    with Control("--set", "bus.protocol=dbc:nowhere.dbc") as control:
        status, _, err = control.finish()
    assert status == 78
    assert "nowhere.dbc" in err or "bus.dbc" in err


@pytest.mark.requirement(id="SR-5.4")
def test_denied_real_time_is_refused_without_a_frame_unless_the_rig_allows_it():
    asked = ["--set", "timing.realtime=true", "--set", "timing.cpu=1023"]  # a core no machine has
    with emulated() as emulator, Control(*asked, "--ticks", "50") as control:
        status, _, err = control.finish()
        assert status == 77
        assert "core refused (core 1023" in err
        assert "allow_degraded" in err
        assert emulator.commands == []
    with emulated(), Control(*asked, "--set", "timing.allow_degraded=true", "--ticks", "50") as control:
        status, out, _ = control.finish()
    assert status == 0
    assert "real time degraded: core refused" in out
    with RingReader(runtime_paths("paper").ring) as ring:
        assert "core refused" in ring.metadata["realtime"]
        assert not any(ring.read().records["flags"] & REALTIME_OK)
    timing = read_timing(runtime_paths("paper").timing)
    assert not timing.realtime_ok
    assert "core refused" in timing.verdict


BROKEN_CYCLE = """
import hil.cycle.step
step = hil.cycle.step.ControlCycle.step
def breaking(self, tick, frames):
    if tick.index >= 50:
        raise ZeroDivisionError("a bug in the law")
    return step(self, tick, frames)
hil.cycle.step.ControlCycle.step = breaking
"""


@pytest.mark.replaces_methods
def test_an_exception_in_the_cycle_stops_sending_and_is_shown_never_hidden():
    with emulated() as emulator:
        with Control(wrap=BROKEN_CYCLE) as control:
            status, _, err = control.finish()
        assert 0 < len(decoded(emulator)) <= 50
    assert status == 70
    assert "ZeroDivisionError: a bug in the law" in err
    with RingReader(runtime_paths("paper").ring) as ring:
        assert not ring.ended  # so that the next start keeps it
        assert not ring.writer_alive


@pytest.mark.requirement(id="SR-5.1")
def test_after_a_kill_the_drives_are_at_zero_and_a_restart_leads_to_ready_never_to_active():
    with emulated() as emulator:
        with Control() as first:
            reader = first.wait_for(State.READY)
            order(CommandKind.ACTIVATE)
            first.wait_for(State.ACTIVE, reader)
            first.process.kill()
            first.process.wait()
        limit = time.monotonic() + PATIENCE_S
        while any(emulator.stage.applied_force) and time.monotonic() < limit:
            time.sleep(0.01)
        assert emulator.stage.applied_force == [0.0, 0.0]
        with Control("--ticks", "100") as second:
            assert second.finish()[0] == 0
    states = set(every_record()["state"].tolist())
    assert states <= {State.BOOT, State.CONNECTED, State.READY, State.FAULT, State.SHUTDOWN}
    with RingReader(previous_path(runtime_paths("paper").ring)) as black_box:
        assert black_box.pid == first.process.pid
        assert State.ACTIVE in black_box.read(100_000).records["state"]


def test_a_second_control_process_for_the_same_rig_is_refused_and_the_first_does_not_notice():
    with emulated(), Control() as first:
        reader = first.wait_for(State.READY)
        with Control() as second:
            status, _, err = second.finish()
        assert status == 69
        assert f"pid {first.process.pid}" in err
        first.wait_for(State.READY, reader)
        first.process.terminate()
        assert first.finish()[0] == 0


def until(reader, seen):
    """Until `seen` holds of the newest record."""
    limit = time.monotonic() + PATIENCE_S
    while time.monotonic() < limit:
        batch = reader.read().records
        if len(batch) and seen(batch[-1]):
            return
        time.sleep(0.01)
    raise AssertionError(f"never seen within {PATIENCE_S} s")


def test_changing_the_rig_file_during_a_run_is_seen_and_forbids_activation(tmp_path):
    rig = tmp_path / "paper.toml"
    rig.write_text(PAPER.read_text())
    with emulated(), Control(rig=rig) as control:
        reader = control.wait_for(State.READY)
        rig.write_text(PAPER.read_text().replace("force = 5.0,", "force = 50.0,"))
        until(reader, lambda record: not record["flags"] & RIG_OK)
        order(CommandKind.ACTIVATE)
        until(reader, lambda record: record["commands_refused"] > 0)
        control.process.terminate()
        assert control.finish()[0] == 0
    records = every_record()
    assert not records["flags"][-1] & RIG_OK
    assert State.ACTIVE not in records["state"]
    assert records["commands_refused"][-1] == 1


def hear_for_ever(listener):
    while True:
        listener.recv(4096)


def test_systemd_hears_of_readiness_and_progress_from_the_loop_alone(tmp_path):
    listener = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    listener.bind(str(tmp_path / "notify"))
    listener.settimeout(PATIENCE_S)
    environment = {"NOTIFY_SOCKET": str(tmp_path / "notify"), "WATCHDOG_USEC": "150000"}
    with listener, emulated(), Control(environment=environment) as control:
        first = listener.recv(4096).decode()
        assert "READY=1" in first.splitlines()
        assert "WATCHDOG=1" in first.splitlines()
        heard, limit = [first], time.monotonic() + PATIENCE_S
        while "STATUS=READY" not in heard[-1]:
            assert time.monotonic() < limit, heard[-1]
            heard.append(listener.recv(4096).decode())
            if len(heard) % 20 == 0:
                order(CommandKind.RESET)  # where this machine has let the drives' watchdogs trip
        assert all("WATCHDOG=1" in text for text in heard)
        control.process.send_signal(signal.SIGSTOP)  # a wedged loop
        os.waitpid(control.process.pid, os.WUNTRACED)
        listener.settimeout(0.3)
        with pytest.raises(TimeoutError):  # what was sent before the stop, then nothing for two watchdog periods
            hear_for_ever(listener)
        control.process.send_signal(signal.SIGCONT)
        control.process.terminate()
        assert control.finish()[0] == 0
