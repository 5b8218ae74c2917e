"""Files of a live rig that somebody cuts short, removes or replaces: nobody dies of it, and stop still stops."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from drivers.base.shared_map import map_shared, shortened, unmap
from hil.cycle.record import RECORD
from hil.cycle.tick import CommandKind
from hil.live.mailbox import Mailbox
from hil.live.ring import RingReader, RingWriter
from hil.live.stop_line import StopLine
from hil.live.stop_page import open_page
from tests.support.paths import ROOT

SLOTS = 1000
SLOTS_OF_BOX = 64


@pytest.mark.requirement(id="SR-7.2")
@pytest.mark.parametrize("size", [0, 1, 7, 100, 4095, 5000])
def test_files_cut_short_end_nothing_and_stop_nothing(size: int, tmp_path: Path) -> None:
    folder = tmp_path / "rig"
    folder.mkdir(mode=0o700)
    record = np.zeros(1, RECORD)[0]
    with (
        StopLine(folder) as line,
        Mailbox.create(folder / "mailbox") as box,
        Mailbox(folder / "mailbox") as sender,
        RingWriter(folder / "ring", SLOTS, metadata={"rig": "one"}) as ring,
        RingReader(folder / "ring") as reader,
    ):
        for number in range(17):
            sender.beat_recorder(time.monotonic_ns())
            assert box.recorder_ok(time.monotonic_ns())
            for name in ("stop", "mailbox", "ring"):
                if size < os.stat(folder / name).st_size:
                    os.truncate(folder / name, size)
            assert not line.pressed()
            assert box.poll() == ()
            assert box.recorder_ok(time.monotonic_ns())
            for _ in range(SLOTS + 10 if number < 2 else 10):
                ring.append(record)
            reader.read()
            page = open_page(str(folder / "stop"))
            assert page is not None
            assert page.press()
            assert line.pressed()
            line.tell("READY", number)
            box.mend()
            ring.mend()
            line.tell_mended(box.mended + ring.mended)
            assert page.status().valid
            assert page.status().mended > number
            line.latched("ESTOP", number)
            assert page.status().latched_state == "ESTOP"
            page.close()
            sender.post(CommandKind.RESET, time.monotonic_ns() + 10**9)
            assert [command.kind for command in box.poll()] == [CommandKind.RESET]
        with RingReader(folder / "ring") as another:
            assert another.metadata == {"rig": "one"}
            assert another.written == ring.written


@pytest.mark.requirement(id="SR-7.2")
@pytest.mark.parametrize("size", [0, 100, 127, 128, 135, 136, 200, 4096])
def test_a_mailbox_that_was_cut_takes_commands_again_however_many_came_before(size: int, tmp_path: Path) -> None:
    with Mailbox.create(tmp_path / "mailbox") as box, Mailbox(tmp_path / "mailbox") as sender:
        for number in range(3 * SLOTS_OF_BOX):
            if number == 2 * SLOTS_OF_BOX:
                os.truncate(tmp_path / "mailbox", size)
                box.poll()
                box.mend()
            sender.post(CommandKind.RESET, time.monotonic_ns() + 10**9)
            assert [command.kind for command in box.poll()] == [CommandKind.RESET]


def test_a_bus_error_of_another_cause_ends_the_process_as_ever(tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-c", "import mmap, os, sys\nfrom drivers.base.shared_map import map_shared\n"
         "fd = os.open(sys.argv[1], os.O_RDWR | os.O_CREAT)\nos.ftruncate(fd, 8192)\nmap_shared(fd, 4096)\n"
         "plain = mmap.mmap(fd, 8192)\nos.ftruncate(fd, 4096)\nplain[5000]", str(tmp_path / "file")],
        cwd=ROOT,
    )  # fmt: skip
    assert done.returncode == -signal.SIGBUS


def test_what_is_not_shortened_is_left_alone(tmp_path: Path) -> None:
    fd = os.open(tmp_path / "file", os.O_RDWR | os.O_CREAT)
    os.ftruncate(fd, 4096)
    mapped = map_shared(fd, 4096)
    mapped[0] = 7
    assert not shortened(mapped)
    os.ftruncate(fd, 0)
    assert mapped[0] == 0
    assert os.fstat(fd).st_size == 4096
    assert (shortened(mapped), shortened(mapped)) == (True, False)
    unmap(mapped)
    assert mapped.closed
    os.close(fd)


def test_a_mapping_inherits_nothing_of_one_that_is_closed(tmp_path: Path) -> None:
    """Its identity may be that of a closed one, which was cut short and never asked about it."""
    fd = os.open(tmp_path / "file", os.O_RDWR | os.O_CREAT)
    os.ftruncate(fd, 4096)
    for _ in range(50):
        mapped = map_shared(fd, 4096)
        assert not shortened(mapped)
        os.ftruncate(fd, 0)
        assert mapped[0] == 0
        unmap(mapped)
        del mapped
    os.close(fd)


def test_a_forked_child_keeps_no_lock(tmp_path: Path) -> None:
    folder = tmp_path / "rig"
    folder.mkdir(mode=0o700)
    reading, writing = os.pipe()
    parent = os.fork()
    if parent == 0:
        line = StopLine(folder)
        ring = RingWriter(folder / "ring", 10)
        child = os.fork()
        if child == 0:
            time.sleep(60)
            os._exit(0)
        os.write(writing, str(child).encode())
        time.sleep(60)
        del line, ring
        os._exit(0)
    child = int(os.read(reading, 16))
    page = open_page(str(folder / "stop"))
    assert page is not None  # while its process lives
    os.kill(parent, signal.SIGKILL)
    os.waitpid(parent, 0)
    try:
        assert not page.status().alive
        StopLine(folder).close()
        RingWriter(folder / "ring", 10).close()
    finally:
        os.kill(child, signal.SIGKILL)
    page.close()
    os.close(reading)
    os.close(writing)
