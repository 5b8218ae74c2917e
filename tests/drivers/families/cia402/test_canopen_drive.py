"""The emulated CANopen drive by itself: object dictionary, PDOs, power states, heartbeats, emergencies."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.families.cia402 import cia301
from drivers.families.cia402.cia301 import Abort, DriveState, Emergency, NmtCommand, NmtState
from drivers.families.cia402.profile import MASTER_ID, rated_torque
from drivers.frame import Frame
from drivers.protocols.base import DriveStatus, Sample
from sim_plant.drives.canopen_drive import Cia402Drive
from sim_plant.drives.object_dictionary import key_of
from sim_plant.drives.power_states import TRANSITIONS
from tests.support.canopen_bench import MS, Bench, make_drive


@pytest.fixture
def bench() -> Bench:
    running = Bench()
    running.bring_up()
    return running


def states(bench: Bench) -> set[DriveState]:
    return {drive.state for drive in bench.drives}


def sdo(drive: Cia402Drive, request: bytes) -> bytes:
    (answer,) = drive.on_frame(Frame(0x600 + drive.node_id, request.ljust(8, b"\0"), 0, drive.now_ns))
    assert answer.can_id == 0x580 + drive.node_id
    return answer.data


def abort_code(answer: bytes) -> int:
    assert answer[0] == 0x80
    return int.from_bytes(answer[4:], "little")


def ready_drive() -> Cia402Drive:
    drive = make_drive(5)
    assert drive.advance(0) == [Frame(0x705, b"\0")]  # boot-up
    return drive


def write(index: int, subindex: int, value: int, size: int) -> bytes:
    return cia301.SDO.pack(0x23 | (4 - size) << 2, index, subindex, value.to_bytes(4, "little"))


def read(index: int, subindex: int = 0) -> bytes:
    return cia301.SDO.pack(0x40, index, subindex, bytes(4))


@pytest.mark.parametrize(
    ("request_", "code"),
    [
        (read(0x5FFF), Abort.NO_OBJECT),
        (read(0x1018, 9), Abort.NO_SUBINDEX),
        (write(0x1000, 0, 1, 4), Abort.READ_ONLY),
        (write(0x6041, 0, 1, 2), Abort.READ_ONLY),
        (write(0x6040, 0, 1, 4), Abort.TOO_LONG),
        (write(0x6076, 0, 1, 2), Abort.TOO_SHORT),
        (write(0x6060, 0, 11, 1), Abort.VALUE_HIGH),
        (write(0x6076, 0, 0, 4), Abort.VALUE_LOW),
        (write(0x6060, 0, 8, 1), Abort.VALUE_RANGE),
        (write(0x1A00, 0, 0, 1), Abort.DEVICE_STATE),  # the PDO is valid
        (write(0x1019, 0, 241, 1), Abort.VALUE_HIGH),
        (bytes((0xA3,)), Abort.COMMAND),  # a block of nothing
        (cia301.SDO.pack(0xA0, 0x1008, 0, b"\0\0\0\0"), Abort.BLOCK_SIZE),  # block upload, no segment a block
        (cia301.SDO.pack(0xA0, 0x5FFF, 0, b"\x7f\0\0\0"), Abort.NO_OBJECT),
        (cia301.SDO.pack(0xC2, 0x2000, 0, b"\1\0\1\0"), Abort.OUT_OF_MEMORY),  # block download of 65537 bytes
        (cia301.SDO.pack(0xC0, 0x1008, 0, bytes(4)), Abort.READ_ONLY),
        (bytes((0x60,)), Abort.COMMAND),  # a segment of nothing
        (bytes((0x00,)), Abort.COMMAND),
    ],
)
def test_the_dictionary_refuses_with_the_code_of_cia_301(request_: bytes, code: Abort) -> None:
    drive = ready_drive()
    assert abort_code(sdo(drive, request_)) == code
    assert sdo(drive, read(0x1000))[4:] == bytes((0x92, 0x01, 0x02, 0x00))  # and goes on serving


def test_what_waits_for_sync_goes_with_its_rpdo_and_is_never_read_by_a_later_mapping() -> None:
    drive = ready_drive()

    def map_torque(*more: int) -> None:
        objects = (0x60710010, *more)
        sdo(drive, write(0x1400, 1, 0x80000205, 4))
        sdo(drive, write(0x1400, 2, 1, 1))
        sdo(drive, write(0x1600, 0, 0, 1))
        for place, mapped in enumerate(objects, 1):
            sdo(drive, write(0x1600, place, mapped, 4))
        sdo(drive, write(0x1600, 0, len(objects), 1))
        assert sdo(drive, write(0x1400, 1, 0x205, 4))[0] == 0x60

    def torque() -> int:
        return int.from_bytes(sdo(drive, read(0x6071))[4:6], "little")

    map_torque()
    drive.on_frame(Frame(0x000, bytes((NmtCommand.START, 5))))
    drive.on_frame(Frame(0x205, b"\x11\0"))
    map_torque(0x60400010)
    drive.on_frame(Frame(0x080, b""))
    assert torque() == 0
    drive.on_frame(Frame(0x205, b"\x22\0\x06\0"))
    drive.on_frame(Frame(0x080, b""))
    assert torque() == 0x22


def test_mapping_what_cannot_be_mapped_is_refused() -> None:
    drive = ready_drive()
    sdo(drive, write(0x1400, 1, 0x80000205, 4))
    assert sdo(drive, write(0x1600, 0, 0, 1))[0] == 0x60
    assert abort_code(sdo(drive, write(0x1600, 1, 0x10000020, 4))) == Abort.NOT_MAPPABLE
    assert abort_code(sdo(drive, write(0x1600, 1, 0x60710020, 4))) == Abort.NOT_MAPPABLE  # 16 bits, not 32
    assert abort_code(sdo(drive, write(0x1600, 1, 0x60640020, 4))) == Abort.NOT_MAPPABLE  # nobody can set a position
    sdo(drive, write(0x1800, 1, 0x80000185, 4))
    sdo(drive, write(0x1A00, 0, 0, 1))
    for place in (1, 2, 3):
        assert sdo(drive, write(0x1A00, place, 0x60640020, 4))[0] == 0x60
    assert abort_code(sdo(drive, write(0x1A00, 0, 3, 1))) == Abort.PDO_LENGTH  # 12 bytes


def test_a_string_travels_in_segments_both_ways_and_a_repeated_toggle_ends_it() -> None:
    drive = ready_drive()
    text = b"a label longer than seven bytes"
    assert sdo(drive, cia301.SDO.pack(0x21, 0x2000, 0, len(text).to_bytes(4, "little")))[0] == 0x60
    segments = [text[at : at + 7] for at in range(0, len(text), 7)]
    for place, segment in enumerate(segments):
        last = place == len(segments) - 1
        head = (place & 1) << 4 | (7 - len(segment)) << 1 | last
        assert sdo(drive, bytes((head,)) + segment)[0] == 0x20 | (place & 1) << 4
    answer = sdo(drive, read(0x2000))
    assert (answer[0], int.from_bytes(answer[4:], "little")) == (0x41, len(text))
    got, toggle = b"", 0
    while True:
        answer = sdo(drive, bytes((0x60 | toggle << 4,)))
        got += answer[1 : 8 - (answer[0] >> 1 & 7)]
        toggle ^= 1
        if answer[0] & 1:
            break
    assert got == text
    sdo(drive, read(0x2000))
    sdo(drive, bytes((0x60,)))
    assert abort_code(sdo(drive, bytes((0x60,)))) == Abort.TOGGLE


ALL = 0b1111


def operational(drive: Cia402Drive) -> None:
    drive.on_frame(Frame(0, bytes((NmtCommand.START, drive.node_id)), 0, drive.now_ns))


def test_pdos_flow_only_in_operational() -> None:
    drive = ready_drive()
    sync = Frame(0x080, b"", 0, MS)
    assert drive.on_frame(sync) == []
    operational(drive)
    (tpdo,) = drive.on_frame(sync)
    assert (tpdo.can_id, len(tpdo.data)) == (0x185, 6)
    drive.on_frame(Frame(0, bytes((NmtCommand.STOP, 0)), 0, 2 * MS))
    assert drive.on_frame(sync) == []
    assert drive.on_frame(Frame(0x605, read(0x1000), 0, 2 * MS)) == []  # nor are there SDOs when stopped


@pytest.mark.parametrize("path", TRANSITIONS, ids=lambda path: f"{path[0].name} {path[1].name}")
def test_the_power_state_machine_follows_the_table_and_ignores_the_rest(path: tuple[DriveState, object]) -> None:
    words = {"SHUTDOWN": 6, "SWITCH_ON": 7, "ENABLE": 15, "DISABLE_VOLTAGE": 0, "QUICK_STOP": 2}
    start, command = path
    drive = ready_drive()
    drive.state = start
    sdo(drive, write(0x6040, 0, words[command.name], 2))  # type: ignore[attr-defined]
    assert drive.state is TRANSITIONS[path]  # type: ignore[index]
    drive.state = DriveState.SWITCH_ON_DISABLED
    sdo(drive, write(0x6040, 0, words["ENABLE"], 2))
    assert drive.state is DriveState.SWITCH_ON_DISABLED


def test_heartbeats_come_in_the_time_written_and_the_masters_silence_is_a_fault() -> None:
    drive = ready_drive()
    sdo(drive, write(0x1017, 0, 50, 2))
    sdo(drive, write(0x1016, 1, MASTER_ID << 16 | 100, 4))
    beats = [time for time in range(400) if drive.advance(time * MS)]
    assert beats == list(range(50, 400, 50))
    drive.on_frame(Frame(0x700 + MASTER_ID, b"\5", 0, 400 * MS))
    frames = [frame for time in range(401, 600) for frame in drive.advance(time * MS) if frame.can_id == 0x085]
    assert [frame.data[:2] for frame in frames] == [Emergency.HEARTBEAT.to_bytes(2, "little")]
    assert drive.state is DriveState.FAULT
    assert drive.nmt is NmtState.PRE_OPERATIONAL


def test_a_short_rpdo_and_a_sync_without_its_counter_are_emergencies_not_commands(bench: Bench) -> None:
    bench.enable, bench.force = ALL, [1.0, 1.0, 0.01, 0.5]
    bench.tick(4)
    bench.heard = bench.to_drives(Frame(0x201, b"\1\2\3"))
    assert {frame.data[:2] for frame in bench.heard} == {Emergency.PDO_TOO_SHORT.to_bytes(2, "little")}
    bench.heard = bench.to_drives(Frame(0x080, b""))
    assert {frame.data[:2] for frame in bench.heard} == {Emergency.SYNC_LENGTH.to_bytes(2, "little")}
    assert bench.drives[0].servo.force == pytest.approx(1.0, abs=1e-3)


def test_a_torque_beyond_6072h_is_limited_and_says_so(bench: Bench) -> None:
    bench.enable = ALL
    bench.tick(3)
    bench.now += MS
    bench.to_drives(Frame(0x201, (32767).to_bytes(2, "little") * 4))
    bench.heard = bench.to_drives(Frame(0x080, bytes((bench.sent[1].data[0] % 240 + 1,))))
    outcomes = [bench.host.decode(frame) for frame in bench.heard]
    limited = [bool(o.status & DriveStatus.TORQUE_LIMITED) for o in outcomes if isinstance(o, Sample)]
    assert limited == [rated_torque(rated)[1] < 32767 for rated in bench.rated]
    assert all(d.servo.force <= r * 1.000001 for d, r in zip(bench.drives, bench.rated, strict=True))


@given(
    frames=st.lists(
        st.tuples(st.sampled_from([0, 0x80, 0x201, 0x301, 0x601, 0x77F]), st.binary(max_size=8)), max_size=30
    )
)
def test_no_frame_upsets_a_drive_and_none_but_a_whole_command_moves_it(frames: list[tuple[int, bytes]]) -> None:
    drive = make_drive()
    for time, (can_id, data) in enumerate(frames):
        drive.on_frame(Frame(can_id, data, 0, time * MS))
        assert abs(drive.servo.force) <= 5.3 * 1.000001
        assert drive.state is DriveState.OPERATION_ENABLED or drive.servo.force == 0.0


@pytest.mark.parametrize("state", DriveState, ids=lambda state: state.name)
def test_the_statusword_has_the_bits_of_cia_402(state: DriveState) -> None:
    """Besides the state's: 4 voltage enabled, 9 remote, 12 follows the command; from ready to switch on, enabled."""
    drive = ready_drive()
    drive.state = state
    word = int.from_bytes(sdo(drive, read(0x6041))[4:6], "little")
    switched_on = state in (DriveState.READY_TO_SWITCH_ON, DriveState.SWITCHED_ON, DriveState.OPERATION_ENABLED)
    enabled = state is DriveState.OPERATION_ENABLED
    assert cia301.drive_state(word) is state
    assert (word >> 4 & 1, word >> 9 & 1, word >> 12 & 1) == (switched_on, 1, enabled)


def test_a_reset_fault_clears_the_error_register_and_says_so() -> None:
    drive = ready_drive()
    drive.servo.fail()
    frames = drive.advance(MS)
    assert drive.state is DriveState.FAULT
    assert sdo(drive, read(0x1001))[4] & 1
    assert [frame.data[2] & 1 for frame in frames if frame.can_id == 0x085] == [1]
    sdo(drive, write(0x6040, 0, 0, 2))
    frames = drive.on_frame(Frame(0x605, write(0x6040, 0, 0x80, 2), 0, 2 * MS))
    assert drive.state is DriveState.SWITCH_ON_DISABLED
    assert sdo(drive, read(0x1001))[4] == 0
    assert [frame.data[:3] for frame in frames if frame.can_id == 0x085] == [bytes(3)]


@pytest.mark.parametrize(("force", "shown"), [(5.3, 32767), (-5.3, -32768)])
def test_a_torque_beyond_what_its_object_holds_stays_at_its_end(bench: Bench, force: float, shown: int) -> None:
    drive = bench.drives[0]
    bench.enable, bench.force[0] = 0b1111, force
    bench.tick(5)
    assert drive.servo.force == pytest.approx(force, rel=1e-2)
    drive.dictionary.values[key_of(0x6076)] = 1  # mN m, of which 6077h shows thousandths
    assert int.from_bytes(sdo(drive, read(0x6077))[4:6], "little", signed=True) == shown
