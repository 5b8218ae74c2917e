"""What the emulated drives say and do in long conversations has not changed, bit by bit. Where a change is meant,
`python -m tests.support.reference conversations` renews tests/reference/conversations.json.
"""

import json
from pathlib import Path
from random import Random

import pytest

from drivers.protocols.base import DriveStatus
from tests.support.conversation_reference import FILE, PIECES, digest, drives, talk

KNOWN = json.loads(FILE.read_text(encoding="utf-8"))["drives"]


def test_there_are_hashes_of_every_conversation(tmp_path: Path) -> None:
    assert set(KNOWN) == set(drives(tmp_path)), "python -m tests.support.reference conversations"
    assert len({piece for pieces in KNOWN.values() for piece in pieces}) == PIECES * len(KNOWN), "they do differ"


@pytest.mark.parametrize("name", KNOWN)
def test_a_drive_says_and_does_what_it_always_did(name: str, tmp_path: Path) -> None:
    node, ask = drives(tmp_path)[name]
    pieces, worked, failed = [], 0, 0
    for lines in talk(node, ask, Random(name)):
        pieces.append(digest(lines))
        status = [int(line.split()[-2]) for line in lines]
        worked += sum(bool(bits & DriveStatus.ENABLED) for bits in status)
        failed += sum(bool(bits & (DriveStatus.FAULT | DriveStatus.WATCHDOG)) for bits in status)
    assert min(worked, failed) >= 50, "a conversation that says nothing of operation or of faults"
    assert pieces == KNOWN[name], f"python -m tests.support.conversation_reference '{name}' PIECE"
