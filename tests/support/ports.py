"""Ports of the loopback that nobody listens on."""

import socket


def free_port() -> int:
    """One that the kernel has just given."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])
