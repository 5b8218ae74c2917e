"""python -m tests.long_runs NAME ...: the long campaigns, one after the other; each prints what did not hold.

loops: random loops against ticks. margins: python-control's margins of 200 drawn rigs. days: 24 h of samples.
wraps: the cycle around each wrap. cut: files of a live rig cut short, stop pressed. cycles: starts and ends.
kills: of each process. Exit status 1 where something did not hold.
"""

import argparse
import sys
from collections.abc import Callable

from tests.long_runs import clocks, lives, loops

VICTIMS = ("sidecar", "teller", "page", "emulator")


def _margins(rigs: int) -> bool:
    from tests.peers import margins
    from tests.peers.table import PASSED

    rows = list(margins.rows(rigs))
    for row in rows:
        if row.result != PASSED:
            print(f"{row.test}: {row.told}")
    passed = sum(row.result == PASSED for row in rows)
    print(f"margins: {passed} of {len(rows)} equal python-control's within 0.1 dB and 0.5 degrees")
    return passed == len(rows)


def _kills(count: int, seed: int) -> bool:
    held = lives.told(lives.kills_of_control(count, seed))
    for victim in VICTIMS:
        held &= lives.told(lives.kills_beside(victim, count, seed))
    return held


def main() -> int:
    """The exit status."""
    parser = argparse.ArgumentParser(prog="python -m tests.long_runs", description=__doc__)
    parser.add_argument("names", nargs="+", choices=["loops", "margins", "days", "wraps", "cut", "cycles", "kills"])
    parser.add_argument("--seed", type=int, default=37)
    parser.add_argument("--count", type=int, help="how many of them [as many as the issue asks for]")
    parser.add_argument("--rate", type=float, default=1000.0, help="Hz, of days")
    parser.add_argument("--hours", type=float, default=24.0, help="of days")
    parser.add_argument("--ticks", type=int, default=1_000_000, help="of wraps, each")
    asked = parser.parse_args()
    campaigns: dict[str, Callable[[], bool]] = {
        "loops": lambda: loops.told(asked.count or 260, (asked.count or 280) // 7, asked.seed),
        "margins": lambda: _margins(asked.count or 200),
        "days": lambda: clocks.told_days(asked.rate, asked.hours),
        "wraps": lambda: clocks.told_wraps(asked.ticks),
        "cut": lambda: lives.told(lives.cut(asked.count or 100, asked.seed)),
        "cycles": lambda: lives.told(lives.cycles(asked.count or 100, asked.seed)),
        "kills": lambda: _kills(asked.count or 50, asked.seed),
    }
    held = [campaigns[name]() for name in asked.names]
    return 0 if all(held) else 1


if __name__ == "__main__":
    sys.exit(main())
