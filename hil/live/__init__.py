"""The control process: the cycle on a real bus at real time; its ring out, its mailbox in."""
