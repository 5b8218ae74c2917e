"""What the service manager is told: readiness, watchdog, status."""

import os
import socket

from hil.live.systemd import Notifier


def test_without_systemd_nothing_is_sent():
    notifier = Notifier({})
    assert notifier.send("READY=1") is False
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
