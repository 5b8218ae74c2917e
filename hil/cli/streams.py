"""The three standard streams: open from the start whatever the caller closed, and written out before the end."""

import os
import sys

_NAMES = ("stdin", "stdout", "stderr")


def open_standard_streams() -> None:
    """A standard descriptor that is closed becomes /dev/null, before anything else is opened.

    Else the next file to be opened, such as a bus or a recording, would have its number and get what is printed.
    """
    for number, name in enumerate(_NAMES):
        try:
            os.fstat(number)
        except OSError:
            opened = os.open(os.devnull, os.O_RDWR)
            if opened != number:
                os.dup2(opened, number)
                os.close(opened)
            os.set_inheritable(number, True)
            setattr(sys, name, os.fdopen(number, "w" if number else "r", errors="replace", closefd=False))


def unwritable_output(last: str = "") -> str:
    """Why standard output takes nothing any more, or nothing; what waits for it is then dropped. last: written, too."""
    try:
        sys.stdout.write(last)
        sys.stdout.flush()
    except OSError as error:
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # else what is left fails again at the end
        return f"standard output: {error.strerror}"
    return ""


def leave() -> None:
    """The last of a command: write out what is left. Raises SystemExit where it cannot be written."""
    if trouble := unwritable_output():
        from hil.cli.exit_status import EXIT_FILE  # `hil estop` loads no more than it must

        say(f"hil: {trouble}")
        sys.exit(EXIT_FILE)


def say(line: str) -> None:
    """A line to standard error, where that can be written."""
    try:
        print(line, file=sys.stderr, flush=True)
    except OSError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), 2)  # else what is left fails again at the end
