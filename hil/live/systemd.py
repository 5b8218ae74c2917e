"""Notifications to systemd (sd_notify(3)): one datagram that never waits."""

import os
import socket


class Notifier:
    """Sends to $NOTIFY_SOCKET, where there is one. watchdog_s: what systemd allows between pings, 0: any time."""

    def __init__(self, environment: "os._Environ[str] | dict[str, str]" = os.environ) -> None:
        path = environment.get("NOTIFY_SOCKET", "")
        self._address = "\0" + path[1:] if path.startswith("@") else path
        self._socket: socket.socket | None = None
        if self._address:
            kind = socket.SOCK_DGRAM | socket.SOCK_CLOEXEC | socket.SOCK_NONBLOCK
            self._socket = socket.socket(socket.AF_UNIX, kind)
        ours = environment.get("WATCHDOG_PID", str(os.getpid())) == str(os.getpid())
        self.watchdog_s = int(environment.get("WATCHDOG_USEC", "0")) / 1e6 if ours else 0.0

    def send(self, *lines: str) -> bool:
        """Send assignments such as "READY=1"; False where nobody took them (that is no reason to stop a loop)."""
        if self._socket is None:
            return False
        try:
            self._socket.sendto("\n".join(lines).encode(), self._address)
        except OSError:
            return False
        return True

    def close(self) -> None:
        """Close; idempotent."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None
