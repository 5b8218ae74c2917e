"""What asks a process of ours to end in good order."""

import signal


def stop_signals() -> tuple[signal.Signals, ...]:
    """SIGTERM, SIGINT, and SIGHUP: the terminal is gone, as when the connection to the rig's machine breaks.

    A process started with nohup, which ignores SIGHUP, is to outlive its terminal.
    """
    asked = (signal.SIGTERM, signal.SIGINT)
    return asked if signal.getsignal(signal.SIGHUP) is signal.SIG_IGN else (*asked, signal.SIGHUP)
