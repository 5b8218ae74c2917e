"""The rules for commit messages refuse what they should, and are applied to what is new alone."""

import subprocess
from pathlib import Path

import pytest

from tests.project.commit_messages import new_commits, problems

GOOD = "Refuse a rig whose layout lacks a status bit\n\nThe bit was lost in silence.\n"


@pytest.mark.parametrize(
    ("message", "told"),
    [
        (GOOD, None),
        (f"{'x' * 72}\n\nwhy\n", None),
        (f"{'x' * 73}\n\nwhy\n", "73 characters"),
        ("Say it\n", "no body"),
        ("Say it\n\nSigned-off-by: someone\n", "no body"),
        ("Say it\n\n# a comment of git\n", "no body"),
        ("Say it.\n\nwhy\n", "full stop"),
        ("Say it\nwhy\n", "no empty line"),
        ("", "0 characters"),
        ("fixup! Say it\n", None),
    ],
)
def test_a_subject_is_short_and_a_body_says_why(message: str, told: str | None) -> None:
    found = problems(message)
    assert (found == []) if told is None else any(told in problem for problem in found)


def test_goldens_change_with_a_reason_beside_them() -> None:
    stories, wires = "tests/golden/stories/paper-push.txt", "tests/golden/wires/wire-1.txt"
    assert problems(GOOD, [stories, "tests/golden/stories/REASONS", "hil/cycle/step.py"]) == []
    assert "wires without a reason" in problems(GOOD, [stories, "tests/golden/stories/REASONS", wires])[0]


def test_only_what_came_after_the_last_tag_is_looked_at(tmp_path: Path) -> None:
    def git(*arguments: str) -> None:
        identity = ("-c", "user.name=n", "-c", "user.email=e@example.org")
        subprocess.run(["git", "-C", tmp_path, *identity, *arguments], check=True, capture_output=True)

    git("init")
    assert new_commits(tmp_path) == [], "no history"
    for number in range(3):
        git("commit", "--allow-empty", "-m", f"commit {number}")
        if number == 0:
            git("tag", "v1")
    assert len(new_commits(tmp_path)) == 2
