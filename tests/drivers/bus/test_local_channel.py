"""The meeting place of a local bus: its lock is waited for, and its channels are listed."""

import contextlib
import os
import stat
from pathlib import Path

import pytest

from drivers.bus import local_channel
from drivers.bus.local_channel import address, channel_dir, channels, locked


def test_the_lock_is_waited_for_until_it_is_given_back(monkeypatch: pytest.MonkeyPatch) -> None:
    directory = channel_dir("can0")
    slept: list[float] = []
    with contextlib.ExitStack() as holder:
        holder.enter_context(locked(directory))

        def sleep(seconds: float) -> None:
            slept.append(seconds)
            if len(slept) == 3:
                holder.close()

        monkeypatch.setattr(local_channel.time, "sleep", sleep)
        with locked(directory):
            assert len(slept) == 3
        assert 0.0 < min(slept) <= max(slept) < 0.1
    with locked(directory):  # it was given back
        pass
    assert len(slept) == 3


def test_a_path_too_long_for_a_socket_has_a_short_address_for_as_long_as_it_is_used(tmp_path: Path) -> None:
    place = tmp_path / ("long" * 30) / "member.sock"
    place.parent.mkdir()
    place.touch()
    before = os.listdir("/proc/self/fd")
    with address(place) as short:
        assert len(short) < 100
        assert Path(short).samefile(place)
    assert os.listdir("/proc/self/fd") == before
    with address(tmp_path / "s") as plain:
        assert plain == str(tmp_path / "s")


def test_channels_are_those_that_somebody_has_used() -> None:
    assert channels() == []
    for name in ("vcan1", "can0", "vcan1"):
        assert stat.S_IMODE(channel_dir(name).stat().st_mode) == 0o700
    assert channels() == ["can0", "vcan1"]
