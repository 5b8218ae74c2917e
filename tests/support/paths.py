"""Where the checkout, its rig files and the laws that users bring are."""

from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
RIGS = ROOT / "deploy" / "rigs"
MISBEHAVES = ROOT / "tests" / "support" / "misbehaves.py"
LAWS_OF_USERS = [*sorted((ROOT / "examples" / "laws").glob("*.py")), MISBEHAVES]
