"""Draw every picture of docs/ anew: `python -m docs.pictures [FOLDER]`."""

import sys
from pathlib import Path

from docs.pictures import fault_story, stage, states, tick, two_laws, wiring

FOLDER = Path(__file__).parent
PICTURES = {
    "stage.svg": stage.draw,
    "wiring.svg": wiring.draw,
    "tick.svg": tick.draw,
    "states.svg": states.draw,
    "two-laws.svg": two_laws.draw,
    "fault-story.svg": fault_story.draw,
}


def main() -> None:
    """Write them into a folder, by default this one."""
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else FOLDER
    folder.mkdir(exist_ok=True)
    for name, draw in PICTURES.items():
        draw(folder / name)


if __name__ == "__main__":
    main()
