"""The envelope: the truth of all cases, with a random word, behind its SHA-256.

Whoever has the hash alone learns nothing, and nobody can put another truth in its place afterwards.
"""

import hashlib
import json
import secrets
from collections.abc import Sequence
from pathlib import Path

from tests.sealed.draw import Case

_HASH = "sealed.sha256"
_TRUTH = "sealed.json"


def close(folder: Path, seed: int, cases: Sequence[Case]) -> str:
    """Write the truth and its hash; the hash."""
    truth = {"nonce": secrets.token_hex(32), "seed": seed, "cases": [case._asdict() for case in cases]}
    text = json.dumps(truth)
    (folder / _TRUTH).write_text(text, encoding="utf-8")
    digest = hashlib.sha256(text.encode()).hexdigest()
    (folder / _HASH).write_text(digest + "\n", encoding="utf-8")
    return digest


def opened(folder: Path) -> list[Case]:
    """The truth. Raises ValueError where it is not what was sealed."""
    text = (folder / _TRUTH).read_text(encoding="utf-8")
    if hashlib.sha256(text.encode()).hexdigest() != (folder / _HASH).read_text(encoding="utf-8").strip():
        raise ValueError(f"{folder}: the truth is not the one that was sealed")
    rows = json.loads(text)["cases"]
    return [Case(**{**row, "more": tuple((kind, value) for kind, value in row["more"])}) for row in rows]
