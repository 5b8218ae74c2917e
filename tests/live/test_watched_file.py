"""A rig file that changes under a running loop is seen, whatever takes its place."""

import os

import pytest

from hil.live.watched_file import WatchedFile


def test_a_file_that_is_touched_or_written_back_has_not_changed(tmp_path):
    path = tmp_path / "rig.toml"
    path.write_text("a = 1")
    watched = WatchedFile(path)
    assert watched.unchanged()
    os.utime(path, (1, 1))
    assert watched.unchanged()
    path.write_text("a = 2")
    assert not watched.unchanged()
    assert not watched.unchanged()
    path.write_text("a = 1")
    assert watched.unchanged()


@pytest.mark.parametrize("how", ["a pipe nobody writes to", "a file of a terabyte", "a directory"])
def test_whatever_takes_the_place_of_the_rig_file_holds_the_loop_up_no_longer_than_a_look(tmp_path, how):
    path = tmp_path / "rig.toml"
    path.write_text("a = 1")
    watched = WatchedFile(path)
    path.unlink()
    if how == "a pipe nobody writes to":
        os.mkfifo(path)
    elif how == "a directory":
        path.mkdir()
    else:
        path.write_text("a = 1")
        os.truncate(path, 2**40)  # all holes; reading it would take minutes and all memory
    assert not watched.unchanged()


@pytest.mark.parametrize("how", ["replace", "remove", "same size and time"])
def test_every_way_of_changing_a_file_is_seen(tmp_path, how):
    path = tmp_path / "rig.toml"
    path.write_text("a = 1")
    os.utime(path, (1, 1))
    watched = WatchedFile(path)
    if how == "replace":
        (tmp_path / "new").write_text("a = 2")
        os.replace(tmp_path / "new", path)
    elif how == "remove":
        path.unlink()
    else:
        path.write_text("a = 2")
        os.utime(path, (1, 1))
    assert not watched.unchanged()
