"""The rules for commit messages, over what is new: `python -m tests.project.commit_messages`, part of `make lint`.

    python -m tests.project.commit_messages           every commit since the last tag; without a tag, since FIRST
    python -m tests.project.commit_messages FILE      the message in FILE, as git's hook commit-msg gives it

A subject says the change in at most 72 characters, and a body says why. A commit that changes goldens keeps the reason
beside them.
"""

import re
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from tests.support.paths import ROOT

FIRST = "c849ce8"  # commits up to it were made before these rules
LONGEST = 72
GOLDEN = re.compile(r"tests/golden/(\w+)/[^/]+\.txt")
MERGES_AND_FIXUPS = ("Merge ", "fixup! ", "squash! ", "Revert ")


def problems(message: str, changed: Sequence[str] = ()) -> list[str]:
    """What is wrong with a message. changed: paths that its commit changes."""
    lines = [line for line in message.rstrip().split("\n") if not line.startswith("#")] or [""]
    subject, rest = lines[0], lines[1:]
    body = [line for line in rest if line.strip() and not re.match(r"[A-Z][\w-]+: \S+", line)]  # trailers say no reason
    if subject.startswith(MERGES_AND_FIXUPS):
        return []
    found = []
    if not subject or len(subject) > LONGEST:
        found.append(f"subject has {len(subject)} characters, allowed 1 to {LONGEST}")
    if subject.endswith("."):
        found.append("subject ends with a full stop")
    if rest and rest[0].strip():
        found.append("no empty line after the subject")
    if not body:
        found.append("no body that says why")
    rooms = {match[1] for path in changed if (match := GOLDEN.fullmatch(path))}
    said = {path.removesuffix(".md") for path in changed}  # on its first day the file had this ending
    unsaid = sorted(room for room in rooms if f"tests/golden/{room}/REASONS" not in said)
    if unsaid:
        found.append(
            f"goldens of {', '.join(unsaid)} without a reason: python -m tests.golden --accept ROOM --reason TEXT"
        )
    return found


def git(root: Path, *arguments: str) -> str:
    """What git says. Raises CalledProcessError."""
    return subprocess.run(["git", "-C", root, *arguments], capture_output=True, text=True, check=True).stdout


def new_commits(root: Path) -> list[str]:
    """Since the last tag, else since FIRST; none where this is no checkout with that history."""
    try:
        tags = git(root, "tag", "--merged", "HEAD", "--sort=-creatordate").split()
        return git(root, "rev-list", "--no-merges", "--reverse", f"{tags[0] if tags else FIRST}..HEAD").split()
    except (OSError, subprocess.CalledProcessError):
        return []


def main() -> None:
    """Command line."""
    if sys.argv[1:]:
        named = {sys.argv[1]: problems(Path(sys.argv[1]).read_text(encoding="utf-8"))}
    else:
        named = {
            git(ROOT, "log", "-1", "--format=%h %s", commit).strip(): problems(
                git(ROOT, "log", "-1", "--format=%B", commit),
                git(ROOT, "show", "--name-only", "--format=", commit).split("\n"),
            )
            for commit in new_commits(ROOT)
        }
    told = [f"{name}: {problem}" for name, found in named.items() for problem in found]
    print("\n".join(told) if told else f"commit messages: {len(named)} looked at, all in order")
    sys.exit(bool(told))


if __name__ == "__main__":
    main()
