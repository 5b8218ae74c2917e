"""Recordings: what goes in comes out, cut short or not; a full disk is counted and hurts nobody."""

import errno
import json
import os
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.writer import Writer

from drivers.frame import Frame
from hil.cycle.record import MAX_RECEIVED, MAX_SENT, MOTION_FIELDS, RECORD, REJECT_REASONS
from hil.cycle.record_builder import RecordBuilder
from hil.cycle.tick import BusState, CommandKind, OperatorCommand, PortCounters
from hil.rig.file import document_hash
from hil.telemetry import codec, cycle_codec
from hil.telemetry import telemetry_pb2 as pb
from hil.telemetry.mcap_items import LARGEST_RECORD
from hil.telemetry.recorder import FLUSH_NS, Recorder, write_batch
from hil.telemetry.recording import Recording, RecordingError
from tests.support.paths import ROOT
from tests.support.records import bare_tick, put_axis

FRAMES = st.builds(
    Frame, st.integers(0, 2**32 - 1), st.binary(max_size=64), st.integers(0, 7), st.integers(-(2**63), 2**63 - 1)
)
COMMANDS = st.tuples(
    st.builds(OperatorCommand, st.sampled_from(CommandKind), st.integers(0, 2**63), st.integers(-(2**62), 2**62)),
    st.booleans(),
)
TICKS = st.tuples(
    st.lists(FRAMES, max_size=MAX_RECEIVED),
    st.lists(FRAMES, max_size=MAX_SENT),
    st.lists(COMMANDS, max_size=4),
    st.integers(0, 31),
)
MODEL = {"mass": 1.0, "coulomb": 0.0, "viscous": 0.0, "gravity": 0.0}
AXIS = {"kind": "linear", "encoder_resolution": 2.0**-20, "limits": {"force": 1.0}, "model": MODEL}
RIG = {"name": "x", "rate_hz": 1000.0, "axes": {"x": AXIS, "y": AXIS, "state": AXIS}}
DIGEST = document_hash(RIG)
METADATA = {"rig": RIG, "rig_hash": DIGEST, "version": "0", "wall_offset_ns": 10}


def _records(ticks: list[tuple[list[Frame], list[Frame], list[tuple[OperatorCommand, bool]], int]]) -> np.ndarray:
    records = np.zeros(len(ticks), RECORD)
    for index, (received, sent, commands, flags) in enumerate(ticks):
        builder = RecordBuilder(3)
        tick = bare_tick(index * 2, index * 1000 + 7, scheduled_ns=index * 1000, flags=flags)
        builder.tick(tick, 4, 0, 1 << 40, sending=bool(flags & 16))
        builder.progress(index, -1)
        for axis, stamp_ns in enumerate((index, -5, 2**60)):
            put_axis(builder, axis, [index + 10.0 * axis + place for place in range(9)], stamp_ns, axis)
        builder.drives([0, 1, 2], [1, 2, 4])
        port = PortCounters(received=index, sent=2**40, state=BusState.ERROR_PASSIVE)
        builder.counters(port, list(range(REJECT_REASONS)), 5, 6, 7)
        builder.law_floors(8)
        builder.missed(9, 10, 11, 12)
        records[index] = builder.traffic(commands, sent, received)
    return records


def test_every_number_of_a_record_is_in_its_own_field() -> None:
    record = _records([([], [], [], 21)])[0]
    values = (0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, -5.0, 7.0, 8.0)  # the following error is worked out
    for field, value in zip(MOTION_FIELDS, values, strict=True):
        offsets = [0.0, 0.0, 0.0] if field == "following_error" else [0.0, 10.0, 20.0]
        assert record[field].tolist() == [value + offset for offset in offsets] + [0.0], field
    assert (record["state"], record["fault"], record["flags"], record["sequence"]) == (4, 0, 21, 0)
    assert (record["faults_active"], record["task_ns"]) == (1 << 40, -1)
    assert record["age_ticks"].tolist() == [0, 1, 2, 0]
    assert record["drive_status"].tolist() == [1, 2, 4, 0]
    assert record["rejects"].tolist() == list(range(REJECT_REASONS))
    counters = ("samples_lost", "missed_own", "missed_host", "longest_streak")
    assert [record[name] for name in counters] == [5, 9, 10, 11]
    assert [record[name] for name in ("illegal_events", "commands_refused", "law_floors")] == [6, 7, 8]
    assert record["saturations"].tolist() == [0, 1, 2, 0]
    assert record["run_delay_ns"] == 12


def test_a_number_too_large_for_its_field_does_not_end_the_loop() -> None:
    """After 50 days at 1 kHz the sequence has more than 32 bits; a process that was stopped has stages of seconds."""
    builder = RecordBuilder(1)
    builder.tick(bare_tick(2**33, 0, flags=15), 4, 34, 0, sending=True)
    builder.progress(2**32 + 5, 0)
    builder.drives([2**32 + 1], [2**31])
    builder.spent(2**31, 2**40, 7, 2**33, 2**32 - 1)
    builder.missed(0, 0, 0, 2**35)
    record = builder.traffic([(OperatorCommand(CommandKind.STOP, 2**64 - 1, 2**70), True)], [], [])
    assert (record["index"], record["sequence"], record["fault"], record["flags"]) == (2**33, 5, 34, 31)
    assert (record["age_ticks"][0], record["drive_status"][0]) == (1, 2**31)
    assert record["cpu_ns"].tolist() == [2**31, 2**32 - 1, 7, 2**32 - 1, 2**32 - 1]
    assert record["run_delay_ns"] == 2**32 - 1
    assert record["commands"][0]["sequence"] == 2**64 - 1
    assert record["commands"][0]["expires_ns"] == 2**63 - 1


def test_a_frame_leaves_nothing_of_a_longer_one_that_had_its_place() -> None:
    builder = RecordBuilder(1)
    builder.traffic([], [Frame(1, b"\xff" * 64)], [Frame(2, b"\xff" * 64)] * 2)
    record = builder.traffic([], [Frame(1, b"\x01" * 5)], [Frame(2, b"\x02" * 16), Frame(3, b"")])
    for name, place, data in (("sent", 0, b"\x01" * 5), ("received", 0, b"\x02" * 16), ("received", 1, b"")):
        assert record[name][place]["data"].tobytes() == data.ljust(64, b"\0")
        assert record[name][place]["length"] == len(data)


@settings(max_examples=40, deadline=None)
@given(st.lists(TICKS, min_size=1, max_size=5))
def test_everything_replay_needs_survives_the_way_through_protobuf(ticks: list) -> None:
    message = pb.Cycle.FromString(cycle_codec.encode(_records(ticks), 3, first=5).SerializeToString())
    found = list(cycle_codec.recorded_ticks(message))
    assert [step.ring for step in found] == [5 + place for place in range(len(ticks))]
    for place, (received, sent, commands, flags) in enumerate(ticks):
        step = found[place]
        assert step.received == received
        assert step.sent == sent
        assert step.tick.commands == tuple(command for command, _ in commands)
        assert (step.tick.index, step.tick.scheduled_ns, step.tick.now_ns) == (
            place * 2,
            place * 1000,
            place * 1000 + 7,
        )
        assert step.tick.port == PortCounters(received=place, sent=2**40, state=BusState.ERROR_PASSIVE)
        bits = (step.tick.stop, step.tick.recorder_ok, step.tick.realtime_ok, step.tick.rig_ok)
        assert bits == tuple(bool(flags >> bit & 1) for bit in range(4))
    assert [command.accepted for command in message.commands] == [ok for tick in ticks for _, ok in tick[2]]


@pytest.mark.parametrize("unit", [1, 200, 1000])
def test_time_stamps_are_told_in_the_unit_they_are_all_multiples_of(unit: int) -> None:
    stamps = [unit * number for number in (10**12 + 1, 10**12 + 4, 10**12 - 6, 10**12 + 1)]
    message = cycle_codec.encode(_records([([Frame(1, b"", 0, stamp)], [], [], 0) for stamp in stamps]), 3)
    assert (message.received.timestamp_unit, list(message.received.timestamp_ns)[1:]) == (unit, [3, -10, 7])
    message.received.timestamp_unit = 0  # as of recordings that have none
    message.received.timestamp_ns[:] = [stamps[0], 3 * unit, -10 * unit, 7 * unit]
    assert [frame.timestamp_ns for tick in cycle_codec.recorded_ticks(message) for frame in tick.received] == stamps


def test_telemetry_columns_are_the_records_fields() -> None:
    records = _records([([], [], [], 0)] * 4)
    message = pb.Telemetry.FromString(codec.telemetry(records, 3, batch=9, lost=1).SerializeToString())
    columns = codec.columns(message)
    assert (message.batch, message.lost, message.axes) == (9, 1, 3)
    for name in codec.PER_TICK:
        assert columns[name].tolist() == records[name].tolist()
    for name in codec.PER_AXIS:
        assert columns[name].tolist() == records[name][:, :3].tolist()
    assert message.counters.sent == 2**40
    assert message.counters.bus_state == BusState.ERROR_PASSIVE


def _write(path: Path, messages: int) -> Recorder:
    recorder = Recorder(path, METADATA)
    noise = np.random.default_rng(1)
    for index in range(messages):
        recorder.write("status", index, pb.Status(rig=noise.bytes(1500).hex(), index=index).SerializeToString())
    return recorder


def _read(path: Path) -> tuple[list[int], Recording]:
    recording = Recording(path)
    return [pb.Status.FromString(item.data).index for item in recording], recording


def test_a_closed_recording_holds_every_message_with_wall_clock_times(tmp_path: Path) -> None:
    recorder = _write(tmp_path / "run.mcap", 100)
    assert recorder.ok
    recorder.close()
    indices, recording = _read(tmp_path / "run.mcap")
    assert indices == list(range(100))
    assert not recording.truncated
    assert recording.metadata == METADATA
    assert [item.time_ns for item in recording][:3] == [10, 11, 12]
    assert recorder.errors == 0


def test_what_went_in_and_out_has_the_wall_clock_time_of_its_last_tick_and_says_what_is_missing(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "run.mcap", METADATA | {"wall_offset_ns": 1_000_000})
    write_batch(recorder, _records([([], [], [], 0)] * 3), first=7, lost=2)
    write_batch(recorder, _records([([], [], [], 0)] * 2), first=10, lost=0)
    write_batch(recorder, _records([([], [], [], 0)] * 2), first=15, lost=3)
    recorder.close()
    cycles = [item for item in Recording(tmp_path / "run.mcap") if item.topic == "cycle"]
    assert [item.time_ns for item in cycles] == [1_000_000 + 1007, 1_000_000 + 1007]
    found = [pb.Cycle.FromString(item.data) for item in cycles]
    assert [(cycle.first, cycle.lost, len(cycle.index)) for cycle in found] == [(7, 2, 5), (15, 3, 2)]


def test_no_message_holds_more_than_a_thousand_ticks_however_many_come_at_once(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "run.mcap", METADATA)
    write_batch(recorder, _records([([], [], [], 0)] * 2300), first=7, lost=2)
    recorder.close()
    found = [pb.Cycle.FromString(item.data) for item in Recording(tmp_path / "run.mcap") if item.topic == "cycle"]
    assert [(cycle.first, cycle.lost, len(cycle.index)) for cycle in found] == [
        (7, 2, 1000), (1007, 0, 1000), (2007, 0, 300),
    ]  # fmt: skip


def test_a_recording_describes_its_own_messages_to_foreign_tools(tmp_path: Path) -> None:
    from mcap.reader import make_reader
    from mcap_protobuf.decoder import DecoderFactory

    recorder = Recorder(tmp_path / "run.mcap", METADATA)
    write_batch(recorder, _records([([], [], [], 0)] * 3), first=7, lost=0)
    recorder.close()
    with (tmp_path / "run.mcap").open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        found = list(reader.iter_decoded_messages(topics=["tick"]))
        schema, channel, _, message = found[0]
        assert (schema.name, channel.topic) == ("hil.telemetry.Tick", "tick")
        assert [where.log_time for _, _, where, _ in found] == [10, 1010, 2010]
        assert [(tick.tick, tick.sequence) for _, _, _, tick in found] == [(0, 7), (2, 8), (4, 9)]
        assert [message.x.position, message.y.position, message.axis_state.position] == [0.0, 10.0, 20.0]
        states = type(message).DESCRIPTOR.fields_by_name["state"].enum_type.values_by_number
        assert states[message.state].name == "ACTIVE"
        assert json.loads(channel.metadata["units"])["x.position"] == "m"
        assert json.loads(channel.metadata["steps"])["x.position"] == 2.0**-21  # half a count
        assert [(item.name, item.metadata["rig_hash"]) for item in reader.iter_metadata()] == [("hil", DIGEST)]


def test_a_recording_cut_short_anywhere_is_readable_up_to_there(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    _write(path, 200).close()
    whole = path.read_bytes()
    counts = []
    for size in range(4096, len(whole), len(whole) // 23):
        path.write_bytes(whole[:size])
        indices, recording = _read(path)
        assert recording.truncated
        assert indices == list(range(len(indices)))
        counts.append(len(indices))
    assert counts == sorted(counts)
    assert counts[-1] > 150


def test_a_recorder_that_was_never_closed_leaves_a_readable_file(tmp_path: Path) -> None:
    recorder = _write(tmp_path / "run.mcap", 200)
    recorder.write("status", FLUSH_NS, pb.Status(index=200).SerializeToString())
    indices, recording = _read(tmp_path / "run.mcap")
    recorder.close()
    assert recording.truncated
    assert indices == list(range(201))


def test_a_recording_is_never_overwritten_and_only_owner_and_group_may_read_it(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    _write(path, 3).close()
    before = path.read_bytes()
    second = Recorder(path, METADATA)
    assert (second.ok, second.errors, second.problem) == (False, 1, "File exists")
    (tmp_path / "link.mcap").symlink_to(tmp_path / "elsewhere")
    assert not Recorder(tmp_path / "link.mcap", METADATA).ok
    assert path.read_bytes() == before
    assert path.stat().st_mode & 0o007 == 0
    assert not (tmp_path / "elsewhere").exists()


def test_a_pipe_is_refused_at_once_and_a_chunk_that_would_fill_the_memory_is_not_unpacked(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(RecordingError, match="not a recording"):
        Recording(tmp_path / "pipe")
    recorder = Recorder(tmp_path / "bomb.mcap", METADATA)
    recorder.write("status", 0, bytes(LARGEST_RECORD + 1))
    recorder.close()
    assert (tmp_path / "bomb.mcap").stat().st_size < 2**16
    indices, recording = _read(tmp_path / "bomb.mcap")
    assert (indices, recording.truncated) == ([], True)


def test_a_full_disk_is_counted_and_never_raises() -> None:
    recorder = Recorder(Path("/dev/full"), METADATA)
    for index in range(100):
        recorder.write("status", index, bytes(5000))
    recorder.close()
    assert not recorder.ok
    assert recorder.errors > 0


@pytest.mark.parametrize("messages", [0, 3])
def test_of_a_disk_that_fills_a_recording_that_has_no_tick_yet_goes(
    messages: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    recorder = _write(tmp_path / "run.mcap", messages)
    assert (tmp_path / "run.mcap").exists()
    monkeypatch.setattr(recorder._writer, "add_message", full)
    recorder.write("status", 0, b"")
    assert (recorder.ok, recorder.errors, recorder.problem) == (False, 1, "No space left on device")
    assert not (tmp_path / "run.mcap").exists()


def test_a_disk_that_is_full_from_the_start_leaves_no_empty_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object, **__: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(Writer, "start", full)
    recorder = Recorder(tmp_path / "run.mcap", METADATA)
    assert (recorder.ok, recorder.errors) == (False, 1)
    assert not (tmp_path / "run.mcap").exists()


def test_a_directory_that_cannot_be_written_is_counted_and_never_raises() -> None:
    recorder = Recorder(Path("/proc/nowhere/run.mcap"), METADATA)
    recorder.write("status", 0, b"")
    recorder.close()
    assert (recorder.ok, recorder.errors) == (False, 1)


@pytest.mark.parametrize("content", [b"", b"\x89MCAP0\r\n", bytes(1000), b"\x89MCAP0\r\n" + b"\xff" * 100])
def test_a_file_that_is_no_recording_is_refused_by_name(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "x.mcap").write_bytes(content)
    with pytest.raises(RecordingError, match=r"x\.mcap: not a recording"):
        Recording(tmp_path / "x.mcap")


def test_a_missing_recording_is_refused_by_name(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=r"x\.mcap: No such file"):
        Recording(tmp_path / "x.mcap")


def test_the_generated_module_matches_the_proto_file(tmp_path: Path) -> None:
    from google.protobuf import descriptor_pb2
    from grpc_tools import protoc

    root = ROOT
    output = tmp_path / "descriptors"
    arguments = ["", f"--proto_path={root}", f"--descriptor_set_out={output}", "hil/telemetry/telemetry.proto"]
    assert protoc.main(arguments) == 0
    [expected] = descriptor_pb2.FileDescriptorSet.FromString(output.read_bytes()).file
    for field in (field for message in expected.message_type for field in message.field):
        field.ClearField("json_name")
    assert descriptor_pb2.FileDescriptorProto.FromString(pb.DESCRIPTOR.serialized_pb) == expected
