"""The console script, and `python -m hil`, for machines where that is not on the path."""

import io
import os
import sys

_WHO_READ_IS_GONE = 1  # exit status, as where a command has begun


def main() -> None:
    """Entry point: imports nothing before a Ctrl-C is taken quietly, as half a second goes into imports.

    Exit status 74: what was left to print could not be written, as on a full disk.
    """
    try:
        from hil.cli.streams import leave, open_standard_streams

        open_standard_streams()
        try:
            _command()
        finally:
            leave()
    except KeyboardInterrupt:
        sys.exit(130)  # 128 + SIGINT, as where a command has begun


def _command() -> None:
    if len(sys.argv) == 3 and sys.argv[1] == "estop" and not sys.argv[2].startswith("-"):
        from hil.operate.estop import stop_rig

        sys.exit(stop_rig(sys.argv[2]))  # before the command line is loaded: see there
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")  # a terminal that has no such letter gets a question mark
    if sys.argv[1:2] == ["explain"] and len(sys.argv) <= 3 and _explained("".join(sys.argv[2:])):
        return
    if sys.argv[1:2] == ["run"]:  # the control process: it has no use for a command-line library in its memory
        from hil.live.run import main as run

        run(sys.argv[2:])
    from hil.cli.app import main as run_command

    run_command()


def _explained(key: str) -> bool:
    """Print what a key means, in the time that loading the command line would take; False: there is no such key."""
    from hil.rig.key_text import key_text
    from hil.rig.reference import UnknownKeyError

    try:
        text = key_text(key)
    except UnknownKeyError:
        return False
    try:
        print(text, flush=True)
    except BrokenPipeError:  # as `| head` leaves it
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # else what is left fails again at the end
        sys.exit(_WHO_READ_IS_GONE)
    except OSError:
        pass  # `leave` tells it
    return True


if __name__ == "__main__":  # worker processes read this file too
    main()
