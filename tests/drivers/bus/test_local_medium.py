"""One member of a local bus: whom it asks for frames, and that it keeps nothing when it leaves."""

import contextlib
import os
import socket
import warnings
from pathlib import Path

import pytest

from drivers.bus.local_channel import channel_dir
from drivers.bus.local_medium import LocalMedium
from drivers.frame import FD, Frame, to_bytes

HELLO = to_bytes(Frame(1, b"", FD))


def descriptors() -> list[str]:
    """Sockets and epoll sets that this process has open."""
    found = []
    for path in Path("/proc/self/fd").iterdir():
        with contextlib.suppress(OSError):  # that of the listing
            target = os.readlink(path)
            if target.startswith(("socket:", "anon_inode:")):
                found.append(target)
    return sorted(found)


@pytest.mark.parametrize("members", [1, 2, 6])
@pytest.mark.parametrize("loopback", [False, True])
def test_whoever_leaves_has_closed_everything_and_is_missed_by_nobody(members: int, loopback: bool) -> None:
    before = descriptors()
    joined = [LocalMedium("can0", depth=8, loopback=loopback and number == 0) for number in range(members)]
    for medium in joined:
        medium.transmit(HELLO)
    kept = [link for medium in joined for link in medium._links]  # what nobody refers to, Python closes
    assert [medium.others for medium in joined] == [members - 1] * members
    assert len(descriptors()) >= len(before) + members * members
    for left, medium in enumerate(joined, 1):
        medium.close()
        medium.close()  # again does no harm
        for other in joined[left:]:
            with contextlib.suppress(BlockingIOError):
                other.transmit(HELLO)
            assert other.others == members - left - 1
    assert descriptors() == before
    assert len(kept) == members * (members - 1) + loopback
    assert list(channel_dir("can0").glob("*.sock")) == []


def test_the_socket_of_a_dead_member_is_cleared_away_and_one_that_vanishes_is_passed_over(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """With nothing left for the garbage collector."""
    directory = channel_dir("can0")
    dead, gone = directory / "1-0-8.sock", directory / "1-1-8.sock"
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as owner:
        owner.bind(str(dead))
    found = sorted([dead, gone])
    monkeypatch.setattr(Path, "glob", lambda path, pattern: iter(found))
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        medium = LocalMedium("can0", depth=8)
        medium.close()
        del medium
    assert [str(warning.message) for warning in said] == []
    assert not dead.exists()


@pytest.mark.parametrize("others", range(8))
def test_few_others_are_all_read_and_of_many_those_that_have_sent(others: int) -> None:
    """Up to four it is quicker to try each."""
    with contextlib.ExitStack() as all_of_them:
        medium, *rest = (
            all_of_them.enter_context(contextlib.closing(LocalMedium("can0", depth=8))) for _ in range(others + 1)
        )
        for speaker in (None, *rest):
            if speaker is not None:
                speaker.transmit(HELLO)
            found = medium.ready()
            assert len(found) == (others if others <= 4 else speaker is not None)
            for fd in found:
                with contextlib.suppress(BlockingIOError), contextlib.closing(os.fdopen(os.dup(fd), "rb", 0)) as link:
                    link.read(72)
