"""The loop's helpers: who lost a slot, has the rig file changed, what systemd is told."""

import os
import socket
import time

import pytest

from hil.loop import MissLedger
from hil.notify import Notifier
from hil.watched_file import WatchedFile

PERIOD = 1_000_000


@pytest.fixture
def ledger():
    made = MissLedger(PERIOD)
    yield made
    made.close()


def test_a_slot_lost_without_using_the_core_is_the_hosts(ledger):
    ledger.book(2, overrun=2, cpu_ns=60_000, sleeps=10**9)
    assert (ledger.own, ledger.host, ledger.longest) == (0, 2, 2)


def test_a_slot_lost_by_computing_is_our_own(ledger):
    ledger.book(3, overrun=3, cpu_ns=2_500_000, sleeps=10**9)
    assert (ledger.own, ledger.host, ledger.longest) == (2, 1, 3)


def test_a_slot_lost_by_waiting_for_something_is_our_own(ledger):
    ledger.take_stock(0)
    for _ in range(3):
        time.sleep(0.001)  # gives up the core; no pacing sleep accounts for it
    ledger.book(1, overrun=1, cpu_ns=0, sleeps=0)
    assert (ledger.own, ledger.host) == (1, 0)


def test_a_late_wake_is_the_hosts_even_when_the_thread_waited_for_something_before(ledger):
    ledger.take_stock(0)
    time.sleep(0.001)
    time.sleep(0.001)
    ledger.book(4, overrun=0, cpu_ns=9_000_000, sleeps=0)
    assert (ledger.own, ledger.host) == (0, 4)


def test_pacing_sleeps_are_not_taken_for_blocking(ledger):
    ledger.take_stock(100)
    for _ in range(3):
        time.sleep(0.001)
    assert not ledger.take_stock(103)


def test_totals_add_up_and_the_longest_loss_is_kept(ledger):
    for skipped in (1, 4, 2):
        ledger.book(skipped, overrun=skipped, cpu_ns=0, sleeps=10**9)
    assert (ledger.own + ledger.host, ledger.longest) == (7, 4)


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


def test_without_systemd_nothing_is_sent():
    notifier = Notifier({})
    assert not notifier.send("READY=1")
    assert notifier.watchdog_s == 0
    notifier.close()


def test_datagrams_reach_a_path_or_an_abstract_socket(tmp_path):
    for address, bound in ((str(tmp_path / "n"), str(tmp_path / "n")), (f"@hil-{os.getpid()}", f"\0hil-{os.getpid()}")):
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as listener:
            listener.bind(bound)
            notifier = Notifier({"NOTIFY_SOCKET": address})
            assert notifier.send("READY=1", "STATUS=x")
            assert listener.recv(100) == b"READY=1\nSTATUS=x"
            notifier.close()


def test_a_notification_never_waits_and_a_dead_manager_is_no_error(tmp_path):
    path = str(tmp_path / "n")
    notifier = Notifier({"NOTIFY_SOCKET": path})
    assert not notifier.send("WATCHDOG=1")
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as listener:
        listener.bind(path)
        sent = 0
        while notifier.send("WATCHDOG=1"):  # until the queue is full; a blocking socket would hang here
            sent += 1
        assert sent > 0
    notifier.close()


def test_the_watchdog_of_another_process_is_not_ours():
    assert Notifier({"WATCHDOG_USEC": "2000000", "WATCHDOG_PID": "1"}).watchdog_s == 0
    assert Notifier({"WATCHDOG_USEC": "2000000", "WATCHDOG_PID": str(os.getpid())}).watchdog_s == 2
