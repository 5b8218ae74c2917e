"""Where the checkout and its rig files are."""

from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
RIGS = ROOT / "deploy" / "rigs"
