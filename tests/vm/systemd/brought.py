"""What a user brings: the examples' classes beside a rig file, and the edits of one that name them."""

import shutil
from pathlib import Path

EXAMPLES = Path("/share/examples")
NETWORK = "./network.py:Network"  # of the examples' laws the one that is stable at 20 Hz, too
BESIDE = (EXAMPLES / "laws" / "network.py", EXAMPLES / "estimators" / "luenberger.py")
# of the shipped microscope at 20 Hz
CLASSES = {
    r'^name = "presliding-kalman"$': f'name = "{NETWORK}"',
    r"^\[estimator\]$": '[estimator]\nname = "./luenberger.py:Luenberger"\nparameters = { bandwidth_hz = 4.0 }',
}
# a rig of 100 Hz, for `hil new`: this guest takes fifty times as long as a rig's PC
SIZES = "--mass 1 --travel 0.05 --encoder 1e-7 --force 20 --friction 0.5 --watchdog 0.05 --rate 100"
BRIEF = "--set task.move_s=0.2 --set task.settle_s=0 --set task.approach_s=0.1"


def bring_all(place: Path) -> None:
    """Every law of the examples, the estimator, the task, and the law that misbehaves, into a new folder."""
    shutil.copytree(EXAMPLES / "laws", place)
    for source in ("examples/estimators/luenberger.py", "examples/tasks/rose.py", "tests/support/misbehaves.py"):
        shutil.copy(Path("/share") / source, place)
