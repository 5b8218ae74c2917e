"""Certificates made by the script that users run."""

import subprocess
from pathlib import Path

from tests.support.paths import ROOT

SCRIPT = ROOT / "deploy" / "zenoh" / "make-certificates.sh"


def certificates(directory: Path, days: int = 30) -> Path:
    """sidecar/, operator/, monitor/ and router/ in `directory`, of the authority there. days: -1: expired."""
    subprocess.run([SCRIPT, directory, str(days)], check=True, capture_output=True)
    return directory
