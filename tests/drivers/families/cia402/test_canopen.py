"""CiA 402 drives and the master that leads them: start-up, enabling, torque, faults, the dictionary's refusals."""

import itertools
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.config import BusConfig, Wiring
from drivers.families.cia402 import cia301
from drivers.families.cia402.cia301 import DriveState, Emergency, NmtCommand
from drivers.families.cia402.drive_plan import FULL_SCALE
from drivers.families.cia402.host import Cia402Host
from drivers.families.cia402.master import HEARTBEAT_TICKS, REPEAT_TICKS, SERVICE_TICKS
from drivers.families.cia402.node import LOST_TICKS, RETRY_TICKS, SDO_TIMEOUT_TICKS, Phase
from drivers.families.cia402.profile import EMCY_ID, MASTER_ID, rated_torque
from drivers.frame import FD, Frame
from drivers.protocols import device_protocol
from drivers.protocols.base import Command, DriveStatus, Reject, Sample
from sim_plant.drives.object_dictionary import key_of
from tests.support.canopen_bench import MS, POSITION, RESOLUTION, WATCHDOG_MS, Bench

ALL = 0b1111


@pytest.fixture
def bench() -> Bench:
    running = Bench()
    running.bring_up()
    return running


def states(bench: Bench) -> set[DriveState]:
    return {drive.state for drive in bench.drives}


# the master -----------------------------------------------------------------------------------------------------------


def test_four_drives_come_up_and_send_their_positions_before_anything_is_enabled(bench: Bench) -> None:
    assert states(bench) == {DriveState.SWITCHED_ON}
    assert [sample.position for sample in bench.samples()] == [
        round(POSITION * node / RESOLUTION) for node in (1, 2, 3, 4)
    ]
    assert all(sample.status == DriveStatus.HOMED | DriveStatus.BRAKE for sample in bench.samples())
    assert all(drive.servo.force == 0.0 for drive in bench.drives)
    assert bench.host.problems == []


def test_every_tick_carries_torques_then_sync_and_at_most_one_service_frame_behind_them() -> None:
    bench = Bench()
    services = []
    for _ in range(500):
        bench.tick()
        assert [frame.can_id for frame in bench.sent[:2]] == [0x201, 0x080]
        assert len(bench.sent) <= 3
        services.append(len(bench.sent) - 2)
    spaced = [index for index, count in enumerate(services) if count]
    assert min(b - a for a, b in itertools.pairwise(spaced)) >= SERVICE_TICKS
    counters = []
    for _ in range(482):
        bench.tick()
        counters.append(bench.sent[1].data[0])
    assert set(counters) == set(range(1, 241))
    assert all(b == a % 240 + 1 for a, b in itertools.pairwise(counters))


def test_the_start_resets_communication_so_that_no_older_mapping_survives() -> None:
    bench = Bench()
    bench.tick()
    assert bench.sent[2] == Frame(cia301.NMT_ID, bytes((NmtCommand.RESET_COMMUNICATION, 0)))


def test_all_drives_are_enabled_by_one_frame_and_apply_their_own_torque(bench: Bench) -> None:
    bench.enable, bench.force = ALL, [5.3, -20.0, 0.01, -0.5]
    bench.tick(3)
    assert states(bench) == {DriveState.OPERATION_ENABLED}
    bench.tick(2)
    for drive, force, rated in zip(bench.drives, bench.force, bench.rated, strict=True):
        unit, _ = rated_torque(rated)
        assert drive.servo.force == pytest.approx(force, abs=0.5 * unit * 1e-6 + (abs(force) == rated) * unit * 1e-6)
    assert all(sample.status & DriveStatus.ENABLED for sample in bench.samples())


def until_sent(bench: Bench, can_id: int) -> None:
    """Tick until the host sends that identifier."""
    for _ in range(HEARTBEAT_TICKS + SERVICE_TICKS):
        bench.tick()
        if can_id in [frame.can_id for frame in bench.sent]:
            return
    pytest.fail(f"the host sent no frame {can_id:#x}")


def test_drives_have_their_torque_from_the_moment_they_are_enabled_and_let_go_at_once(bench: Bench) -> None:
    """Between an enabling frame behind SYNC and the torque of the next SYNC a weight would fall."""
    bench.enable, bench.force = ALL, [1.0, 1.0, 0.01, 0.5]
    at_sync, at_once = cia301.RPDO3_ID + 1, cia301.RPDO2_ID + 1
    until_sent(bench, at_sync)
    assert states(bench) == {DriveState.SWITCHED_ON}
    bench.tick()
    assert states(bench) == {DriveState.OPERATION_ENABLED}
    assert all(drive.servo.force > 0.0 for drive in bench.drives)
    bench.enable = 0b0111
    until_sent(bench, at_once)
    assert [drive.state for drive in bench.drives] == [DriveState.OPERATION_ENABLED] * 3 + [DriveState.SWITCHED_ON]


@pytest.mark.parametrize("failed", [0, 1])
def test_the_last_tick_of_a_host_disables_its_drives_whosever_turn_it_is(failed: int, bench: Bench) -> None:
    """After a damped stop on SIGTERM nothing follows that tick; a drive left enabled would hold its brake open."""
    bench.enable = ALL
    bench.tick(10)
    for drive in bench.drives[:failed]:
        drive.servo.fail()
    until_sent(bench, cia301.HEARTBEAT_ID + MASTER_ID)
    others = bench.drives[failed:]
    assert {drive.state for drive in others} == {DriveState.OPERATION_ENABLED}
    bench.enable = 0
    bench.tick()
    assert {drive.state for drive in others} == {DriveState.SWITCHED_ON}


def test_an_enable_that_waits_for_a_lost_sync_is_taken_back_as_soon_as_it_shows(bench: Bench) -> None:
    """Its SYNC and the next are lost; the disabling frame finds nothing enabled yet, and then SYNC is there again."""
    bench.enable, at_once = ALL, cia301.RPDO2_ID + 1
    until_sent(bench, cia301.RPDO3_ID + 1)
    bench.enable = 0
    sync = [drive._handlers.pop(cia301.SYNC_ID) for drive in bench.drives]
    bench.tick(2)
    assert bench.sent[2].can_id == at_once
    for drive, handler in zip(bench.drives, sync, strict=True):
        drive._handlers[cia301.SYNC_ID] = handler
    bench.tick()
    assert states(bench) == {DriveState.OPERATION_ENABLED}
    assert all(drive.servo.force == 0.0 for drive in bench.drives)
    bench.tick(REPEAT_TICKS)
    assert states(bench) == {DriveState.SWITCHED_ON}


def test_a_drive_whose_enable_bit_is_clear_gets_no_torque_at_once(bench: Bench) -> None:
    bench.enable, bench.force = ALL, [1.0, 1.0, 0.01, 0.5]
    bench.tick(3)
    bench.enable = 0b1110
    bench.tick()
    assert bench.drives[0].servo.force == 0.0
    bench.tick(3)
    assert [drive.state for drive in bench.drives].count(DriveState.OPERATION_ENABLED) == 3
    assert bench.drives[0].state is DriveState.SWITCHED_ON
    assert bench.samples()[0].status == DriveStatus.HOMED | DriveStatus.BRAKE


def test_without_commands_every_drive_is_at_zero_and_in_fault_within_its_watchdog(bench: Bench) -> None:
    bench.enable, bench.force = ALL, [1.0] * 2 + [0.01, 0.5]
    bench.tick(3)
    assert all(drive.servo.force for drive in bench.drives)
    for drive in bench.drives:  # the emulator's part: it stops the physics at this instant
        assert drive.servo.deadline_ns == bench.now + WATCHDOG_MS * MS
        drive.servo.trip(drive.servo.deadline_ns)
    emergencies = [frame for frame in bench.wait(WATCHDOG_MS) if frame.can_id >> 7 == EMCY_ID >> 7]
    assert [frame.can_id - EMCY_ID for frame in emergencies] == [1, 2, 3, 4]
    assert {frame.data[:3] for frame in emergencies} == {Emergency.RPDO_TIMEOUT.to_bytes(2, "little") + b"\x11"}
    assert all(drive.servo.force == 0.0 for drive in bench.drives)
    bench.heard = emergencies
    bench.tick(2)
    assert all(sample.status & (DriveStatus.FAULT | DriveStatus.WATCHDOG) == 6 for sample in bench.samples())


def test_sync_without_new_torques_does_not_feed_the_watchdog(bench: Bench) -> None:
    deadline = bench.drives[0].servo.deadline_ns
    bench.now += 5 * MS
    bench.to_drives(bench.sent[1]._replace(data=bytes((bench.sent[1].data[0] % 240 + 1,))))
    assert bench.drives[0].servo.deadline_ns == deadline


def test_a_fault_is_left_by_a_reset_edge_and_then_only_by_enabling_anew(bench: Bench) -> None:
    bench.enable = ALL
    bench.tick(5)
    bench.drives[2].servo.fail()
    bench.tick(10)
    assert bench.drives[2].state is DriveState.FAULT
    assert bench.samples()[2].status & DriveStatus.FAULT
    bench.reset = True
    bench.tick(30)
    bench.reset = False
    bench.tick(30)
    assert bench.drives[2].state is DriveState.SWITCHED_ON  # the enable bit is still set: it was never seen clear
    bench.enable = 0
    bench.tick(10)
    bench.enable = ALL
    bench.tick(10)
    assert states(bench) == {DriveState.OPERATION_ENABLED}
    assert not any(sample.status & DriveStatus.FAULT for sample in bench.samples())


def test_a_reset_that_stays_set_resets_only_once(bench: Bench) -> None:
    bench.reset = True
    bench.tick(200)
    bench.drives[0].servo.fail()
    bench.tick(200)
    assert bench.drives[0].state is DriveState.FAULT


def test_an_encoder_fault_is_told_by_its_emergency(bench: Bench) -> None:
    bench.drives[1].servo.extra_status = int(DriveStatus.ENCODER_FAULT)
    bench.tick(3)
    assert bench.samples()[1].status & (DriveStatus.FAULT | DriveStatus.ENCODER_FAULT) == 0b1000010


def test_a_lost_controlword_is_sent_again(bench: Bench) -> None:
    bench.enable = ALL
    bench.deaf = {1, 2, 3, 4}
    bench.tick(2)
    bench.deaf = set()
    bench.tick()
    assert states(bench) == {DriveState.SWITCHED_ON}
    bench.tick(25)
    assert states(bench) == {DriveState.OPERATION_ENABLED}


def test_a_drive_that_reboots_is_configured_anew_and_stays_disabled_while_the_others_run(bench: Bench) -> None:
    bench.enable = ALL
    bench.tick(5)
    bench.host.decode(Frame(EMCY_ID + 2, bytes.fromhex("2073010000000000")))
    assert [problem.partition(":")[0] for problem in bench.host.problems] == ["node 2"]
    bench.heard += bench.to_drives(Frame(cia301.NMT_ID, bytes((NmtCommand.RESET_NODE, 2))))
    bench.tick(2)
    assert bench.host.nodes[1].phase is Phase.CONFIGURE
    assert bench.host.problems == []
    bench.tick(300)
    assert bench.host.nodes[1].phase is Phase.RUNNING
    assert [drive.state for drive in bench.drives].count(DriveState.OPERATION_ENABLED) == 3
    assert bench.drives[1].state is DriveState.SWITCHED_ON


def test_a_drive_that_is_not_there_holds_up_nobody_and_is_found_when_it_comes() -> None:
    bench = Bench()
    bench.deaf = {3}
    bench.tick(3 * SDO_TIMEOUT_TICKS + 300)
    assert [node.phase for node in bench.host.nodes] == [Phase.RUNNING, Phase.RUNNING, Phase.CONFIGURE, Phase.RUNNING]
    bench.deaf = set()
    bench.bring_up()


def test_a_drive_that_falls_silent_is_looked_for_again(bench: Bench) -> None:
    bench.deaf = {4}
    bench.tick(LOST_TICKS + 100)
    assert bench.host.nodes[3].phase is Phase.CONFIGURE
    bench.deaf = set()
    bench.bring_up()


def test_a_drive_of_another_profile_is_refused_with_its_reason_and_asked_again_later() -> None:
    bench = Bench()
    bench.tick()  # resets communication, and 1000h with it
    bench.drives[1].dictionary.values[key_of(0x1000)] = 0x00030191  # CiA 401: an I/O module
    bench.tick(100)
    assert bench.host.nodes[1].phase is Phase.REFUSED
    assert bench.host.problems == ["node 2: 1000h = 0x30191; expected 0x192 in the bits 0xffff"]
    bench.drives[1].dictionary.values[key_of(0x1000)] = 0x00020192
    bench.tick(RETRY_TICKS + 300)
    assert bench.host.nodes[1].phase is Phase.RUNNING


def test_a_drive_that_aborts_the_configuration_is_refused_with_the_code() -> None:
    bench = Bench()
    del bench.drives[0].dictionary.setters[key_of(cia301.TORQUE_RATED)]
    entries = dict(bench.drives[0].dictionary.entries)
    entries[key_of(cia301.TORQUE_RATED)] = entries[key_of(cia301.TORQUE_RATED)]._replace(writable=False)
    bench.drives[0].dictionary.entries = entries  # type: ignore[assignment]
    bench.tick(500)
    assert bench.host.problems == ["node 1: 6076h:00 aborted with 0x06010002 (read only)"]


def test_the_samples_stamp_is_the_end_of_sync_whichever_drive_answers_first() -> None:
    host = Cia402Host(Wiring(BusConfig(protocol="cia402"), 2, [1.0, 1.0]))
    frames = [Frame(0x181 + axis, bytes(4) + b"\x23\x02") for axis in range(2)]
    from drivers.frame_length import INTERMISSION, frame_bits

    took = 1000 * (frame_bits(frames[0])[0] + INTERMISSION)
    for order in ((0, 1), (1, 0)):
        host.encode(Command(0, [0.0, 0.0], 0, False))
        arrivals = [frames[axis]._replace(timestamp_ns=MS + took * (place + 1)) for place, axis in enumerate(order)]
        heard = [host.decode(frame) for frame in arrivals]
        for sample in heard:
            assert isinstance(sample, Sample)
            assert abs(sample.stamp_ns - MS) <= 20_000
        host = Cia402Host(Wiring(BusConfig(protocol="cia402"), 2, [1.0, 1.0]))


@given(force=st.floats(1e-4, 1e4))
def test_the_rated_force_is_within_what_6071h_can_say_and_no_step_is_wasted(force: float) -> None:
    unit, limit = rated_torque(force)
    assert limit * unit * 1e-6 <= force * (1 + 1e-9)
    assert force - limit * unit * 1e-6 < unit * 1e-6 * (1 + 1e-9)
    assert limit <= FULL_SCALE
    assert unit == 1 or limit >= FULL_SCALE // 2


def test_a_listener_reads_the_same_torques_as_the_drives(bench: Bench) -> None:
    listener = device_protocol(BusConfig(protocol="cia402"), 4, bench.rated, Path())
    bench.enable, bench.force = ALL, [1.0, -2.0, 0.02, 0.5]
    heard = []
    for _ in range(4):
        bench.tick()
        heard += [listener.decode_command(frame) for frame in bench.sent]
    commands = [command for command in heard if isinstance(command, Command)]
    assert commands[-1].enable == ALL
    assert list(commands[-1].force) == pytest.approx([drive.servo.force for drive in bench.drives])
    answer = listener.encode_feedback(Sample(1, -7, int(DriveStatus.ENABLED | DriveStatus.HOMED), 0, 0))
    sample = bench.host.decode(answer)
    assert isinstance(sample, Sample)
    assert replace(sample, stamp_ns=0) == Sample(1, -7, DriveStatus.ENABLED | DriveStatus.HOMED, -1, 0)


def test_a_listener_takes_the_rated_force_and_refuses_a_step_more(bench: Bench) -> None:
    listener = device_protocol(BusConfig(protocol="cia402"), 4, bench.rated, Path())
    limits = [rated_torque(rated)[1] for rated in bench.rated]

    def told(torques: list[int]) -> Command | Reject:
        return listener.decode_command(
            Frame(0x201, b"".join(raw.to_bytes(2, "little", signed=True) for raw in torques))
        )

    for sign in (1, -1):
        full = [sign * limit for limit in limits]
        heard = told(full)
        assert isinstance(heard, Command)
        assert [abs(force) for force in heard.force] == pytest.approx(bench.rated, rel=1e-3)
        for axis, limit in enumerate(limits):
            if limit < FULL_SCALE:
                more = [raw + sign * (number == axis) for number, raw in enumerate(full)]
                assert told(more) is Reject.INVALID_VALUE


def test_frames_that_are_no_samples_are_refused_for_their_reason(bench: Bench) -> None:
    tpdo = Frame(0x181, bytes(4) + b"\x27\x02")
    cases = {
        Reject.WRONG_LENGTH: tpdo._replace(data=bytes(8)),
        Reject.WRONG_FORMAT: tpdo._replace(flags=FD),
        Reject.INVALID_VALUE: tpdo._replace(data=bytes(4) + b"\x02\x00"),  # no state of CiA 402 has these bits
        Reject.UNKNOWN_ID: tpdo._replace(can_id=0x185),
        Reject.OWN_ECHO: Frame(0x080, b"\1"),
        Reject.SERVICE: Frame(0x701, b"\5"),
    }
    for reason, frame in cases.items():
        assert bench.host.decode(frame) is reason


def test_emergencies_have_identifiers_that_nothing_else_has_below_every_service() -> None:
    last = 127  # node
    taken = {0x000, 0x080, *(base + node for base in (0x580, 0x600, 0x700) for node in range(1, last + 1))}
    emergencies = {EMCY_ID + node for node in range(1, last + 1)}
    assert not emergencies & taken
    assert 0x600 + last < min(emergencies)
    assert EMCY_ID == 0x680
    assert max(emergencies) < 0x700, "more urgent than heartbeats"
