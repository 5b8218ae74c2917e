"""Review and accept goldens (golden.py says what they are).

make review [ROOM]                                        what differs: of one room, or of all that take seconds
python -m tests.golden ROOM --full STORY                  all that a story's hashes stand for, to compare checkouts
python -m tests.golden --accept ROOM --reason TEXT        take one room as it is now; the reason is kept beside it
"""

import argparse
import sys
from collections.abc import Iterable
from datetime import date

from tests.golden.golden import HERE, Change, accept, changes, rooms, teller


def show(found: Iterable[Change]) -> int:
    """Print every difference, a difference that many goldens share once. How many goldens there were."""
    shared: dict[tuple[str, tuple[str, ...]], list[Change]] = {}
    for each in found:
        told = tuple(line for line in each.lines if line[:1] in "+-" or each.kind != "changed")
        shared.setdefault((each.kind, told), []).append(each)
    for (kind, _), alike in shared.items():
        print(f"{kind}: " + ", ".join(str(each.path.relative_to(HERE)) for each in alike))
        print("\n".join(f"    {line}" for line in alike[0].lines))
    return sum(map(len, shared.values()))


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(
        prog="python -m tests.golden", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("room", nargs="?", choices=rooms())
    parser.add_argument("--full", metavar="STORY")
    parser.add_argument("--accept", metavar="ROOM", choices=rooms())
    parser.add_argument("--reason", metavar="TEXT")
    asked = parser.parse_args()
    if bool(asked.accept) != bool(asked.reason):
        parser.error("--accept and --reason go together")
    if asked.accept:
        if asked.room not in (None, asked.accept):
            parser.error("one room at a time")
        try:
            print(f"{show(accept(asked.accept, asked.reason, date.today().isoformat()))} goldens of {asked.accept}")
        except ValueError as error:
            parser.error(str(error))
    elif asked.full:
        if not hasattr(teller(asked.room or rooms()[0]), "full"):
            parser.error("--full needs a room whose goldens leave something out")
        print(*teller(asked.room).full(asked.full), sep="\n")
    else:
        slow = [] if asked.room else [room for room in rooms() if getattr(teller(room), "SLOW", False)]
        looked_at = [asked.room] if asked.room else [room for room in rooms() if room not in slow]
        differ = sum(show(changes(room)) for room in looked_at)
        print(f"{differ} goldens differ in {', '.join(looked_at)}")
        if not asked.room:
            print("not looked at, as they take minutes: " + ", ".join(f"make review {room}" for room in slow))
        sys.exit(differ > 0)


if __name__ == "__main__":
    main()
