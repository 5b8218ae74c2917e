"""What the cycle says in words reaches the sidecar's file, the journal's child and the monitor."""

from pathlib import Path
from types import SimpleNamespace

from drivers.frame import Frame
from drivers.protocols.base import Command, HostProtocol
from drivers.protocols.mounting import MountedHost, Mounting
from hil.events.notes import LONGEST, MOST, Note, NoteWriter, read_notes, read_problems, read_tip
from hil.events.sources import event_of
from hil.events.table import Kind, Severity
from hil.operate.monitor import control_line
from hil.page.words import status_words
from hil.telemetry import telemetry_pb2 as pb
from sim_plant.drives.object_dictionary import key_of
from tests.support.canopen_bench import Bench

LEFT = "the tip may be in a cell: z is beyond its safe height of -0.001; lead it out: hil command r reset, then more"


def says(*problems: str, failure: str = "", tip: str = "") -> SimpleNamespace:
    return SimpleNamespace(problems=list(problems), failure=failure, tip=tip)


def test_a_refusal_keeps_the_tick_it_was_told_in_and_is_read_by_others(tmp_path: Path) -> None:
    path = tmp_path / "notes"
    path.write_text("of a run before\n")
    notes = NoteWriter(path)
    assert read_problems(path) == []
    for tick in (3, 4, 5):
        notes.write(says("node 3: 6502h = 0x5"), tick, 1000 * tick)
    notes.write(says("node 3: 6502h = 0x5", "node 4:\n1000h", failure="law.py:7: it divides by zero"), 9, 9000)
    assert read_problems(path) == ["node 3: 6502h = 0x5", "node 4: 1000h"]
    assert read_notes(path) == [
        Note(Kind.DRIVE, "node 3: 6502h = 0x5", 3, 3000),
        Note(Kind.DRIVE, "node 4: 1000h", 9, 9000),
        Note(Kind.LAW, "law.py:7: it divides by zero", 9, 9000),
    ]
    notes.write(says(), 10, 10000)
    assert read_notes(path) == []


def test_a_flood_of_words_is_bounded(tmp_path: Path) -> None:
    path = tmp_path / "notes"
    NoteWriter(path).write(says(*(f"{number} {'x' * 9999}" for number in range(99))), 1, 1)
    assert len(read_notes(path)) == MOST
    assert all(len(note.text) <= LONGEST for note in read_notes(path))


def test_a_damaged_file_says_nothing(tmp_path: Path) -> None:
    path = tmp_path / "notes"
    for text in ("{}", "[99, 2, 3, 4]", "\x00", '[14, "a"]', "null"):
        path.write_text(text)
        assert read_notes(path) == []


def test_a_runtime_directory_that_is_gone_does_not_end_the_loop(tmp_path: Path) -> None:
    notes = NoteWriter(tmp_path / "gone" / "notes")
    notes.write(says("node 3: 6502h = 0x5"), 1, 1)
    assert [note.text for note in notes.told] == ["node 3: 6502h = 0x5"]


def test_the_monitor_shows_it_under_the_state() -> None:
    status = pb.Status(state="BOOT", control_alive=True, drive_problems=["node 3: 6502h:00 aborted"])
    assert "drive not ready: node 3: 6502h:00 aborted" in control_line(status).plain


def test_a_tip_that_was_left_inside_is_told_with_the_way_out_and_no_longer_than_it_is(tmp_path: Path) -> None:
    notes = NoteWriter(tmp_path / "notes")
    notes.write(says("node 3: no", tip=LEFT), 7, 7000)
    assert read_tip(tmp_path / "notes") == LEFT
    assert read_problems(tmp_path / "notes") == ["node 3: no"], "no drive's problem"
    event = event_of(read_notes(tmp_path / "notes")[-1], 1_000_000)
    assert (event.kind, event.severity, event.tick) == (Kind.TIP, Severity.ERROR, 7)
    assert event.line.endswith("beyond its safe height of -0.001; next: hil command r reset, then more")
    notes.write(says(), 8, 8000)
    assert read_tip(tmp_path / "notes") == ""


def test_monitor_and_page_show_that_the_tip_was_left_inside() -> None:
    status = pb.Status(state="ESTOP", control_alive=True, tip=LEFT)
    assert LEFT in control_line(status).plain
    assert status_words(status)["tip"] == LEFT


def test_mounted_drives_say_it_too() -> None:
    bench = Bench()
    bench.tick()  # resets communication, and 1000h with it
    bench.drives[0].dictionary.values[key_of(0x1000)] = 0x191
    bench.tick(60)
    host: HostProtocol = MountedHost(bench.host, [Mounting(direction=-1)] * 4)
    assert host.encode(Command(0, [0.0] * 4, 0, False))[0] == Frame(0x201, bytes(8))
    assert host.problems == bench.host.problems
    assert "1000h = 0x191" in host.problems[0]
