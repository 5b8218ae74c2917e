"""What a rig file says to any value of any key, as hashes kept in tests/reference/refusal_hashes.json.

python -m tests.support.reference refusals     renew the file, after a change that is meant to change what is refused

Every key of the schema gets every one of VALUES, as `--set` does: it is taken, as another value perhaps, or refused in
words.
"""

import hashlib
import json
from typing import Any

from hil.rig.file import load_rig
from hil.rig.reference import ANY_AXIS, tables
from hil.rig.schema import RigError
from tests.support.paths import RIGS, ROOT

FILE = ROOT / "tests" / "reference" / "refusal_hashes.json"
RIG_NAMES = ("paper", "microscope")
VALUES = ("0", "1", "-1", "2.5", "1e-9", "1e7", "nan", '"x"', "[]", "[0.5, 0.25]", "[2.0, -1.0, 3.0, 1.0]", "{}")


def keys() -> list[str]:
    """All of them, of the axis x and of the whole rig."""
    return [key.path.replace(ANY_AXIS, "x") for table in tables() for key in table.keys]


def outcome(name: str, key: str, value: str) -> str:
    """What comes of one of them: the value that is taken, or the refusal."""
    try:
        found: Any = load_rig(RIGS / f"{name}.toml", [f"{key}={value}"]).model_dump(mode="json")
    except RigError as error:
        return str(error).replace(str(ROOT), "")
    for part in key.split("."):
        found = found.get(part) if isinstance(found, dict) else None
    return json.dumps(found)


def outcomes(name: str) -> dict[str, list[str]]:
    """Of a rig, by key."""
    return {key: [outcome(name, key, value) for value in VALUES] for key in keys()}


def hashes(told: dict[str, list[str]]) -> dict[str, str]:
    """By key."""
    return {key: hashlib.sha256("\n".join(texts).encode()).hexdigest()[:16] for key, texts in told.items()}


def renew() -> None:
    """Write the file anew."""
    known = {name: hashes(outcomes(name)) for name in RIG_NAMES}
    FILE.write_text(json.dumps(known, indent=1) + "\n", encoding="utf-8")
