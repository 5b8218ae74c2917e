"""Open a CAN bus and move frames: the loop's port, SocketCAN, and a local bus that needs no kernel module."""
