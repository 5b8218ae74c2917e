"""A rig file with laws of users beside it."""

import shutil
from pathlib import Path

from tests.support.paths import LAWS_OF_USERS, RIGS

GOOD = {"lqr": "Lqr", "lqg": "Lqg", "mpc": "PreviewMpc", "network": "Network"}
QUICK = ["task.radius=0.01", "task.approach_s=0.2", "task.settle_s=0.1"]


def rig_with_laws(folder: Path) -> Path:
    """paper.toml in a folder of its own, with the users' files beside it."""
    for path in (RIGS / "paper.toml", *LAWS_OF_USERS):
        shutil.copy(path, folder)
    return folder / "paper.toml"


def beside(name: str) -> str:
    """The override that takes one of them."""
    return f"law.name=./{name}.py:{ {**GOOD, 'misbehaves': 'Misbehaves'}[name] }"
