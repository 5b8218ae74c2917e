"""The console script, and `python -m hil`, for machines where that is not on the path."""

import io
import sys


def main() -> None:
    """Entry point: imports nothing before a Ctrl-C is taken quietly, as half a second goes into imports."""
    try:
        if len(sys.argv) == 3 and sys.argv[1] == "estop" and not sys.argv[2].startswith("-"):
            from hil.operate.estop import stop_rig

            sys.exit(stop_rig(sys.argv[2]))  # before the command line is loaded: see there
        for stream in (sys.stdout, sys.stderr):
            if isinstance(stream, io.TextIOWrapper):
                stream.reconfigure(errors="replace")  # a terminal that has no such letter gets a question mark
        if sys.argv[1:2] == ["run"]:  # the control process: it has no use for a command-line library in its memory
            from hil.live.run import main as run

            run(sys.argv[2:])
        from hil.cli.app import main as run_command

        run_command()
    except KeyboardInterrupt:
        sys.exit(130)  # 128 + SIGINT, as where a command has begun


if __name__ == "__main__":  # worker processes read this file too
    main()
