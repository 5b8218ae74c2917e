"""Hostile manifests of `hil install`: an uninstall refuses them by name, or removes what it put there and nothing else.

Half of them are damaged bytes; in the others a few entries are drawn that lead elsewhere, each with the digest that
would let the file go.
"""

import hashlib
import json
import os
import random
from pathlib import Path

from hil.operate.installed import MANIFEST, InstallError, put, read_manifest, remove_all
from tests.fuzz.damage import damaged

_UNITS = "etc/systemd/system/"
FILES = {f"{_UNITS}hil.target": "unit", "etc/sysusers.d/hil.conf": "users", "etc/systemd/network/80-hil-can0.link": "l"}
LINKS = {f"{_UNITS}hil.target.wants/hil-page.service": "/etc/systemd/system/hil-page.service"}
THEIRS = "theirs"  # what a file says that is not ours
_DIGEST = hashlib.sha256(THEIRS.encode()).hexdigest()
_PIECES = [
    "", ".", "..", "/", "~", "-rf", "etc", "passwd", "outside", "linked", "loop", "pipe", "hil.target", "hil-x.service",
    "hil-loop", "hil-pipe", "hil-folder", "hil-linked", "\0", "\ud800", "\n", "x" * 70_000, "é" * 200, "/dev/zero",
    "/proc/kmsg", "etc/systemd/system", "etc/systemd/network/80-hil-", "etc/hil/rigs", "etc/hil/installed.json",
]  # fmt: skip
_OWN_NAMES = ["hil-loop", "hil-pipe", "hil-folder", "hil-linked", "hil.target", "hil-none", "hil.target.wants"]
_VALUES = [_DIGEST, "", "no file", "a directory", "-> /etc/passwd", "-> hil-loop", "-> ..", "\ud800", "x" * 70_000]
_BODIES = ["[" * 200_000, '{"a":' * 50_000, "1" * 5_000, "null", '{"a": {}}', "\ufeff{}", "", '{"a": NaN}']


def _installed(base: Path) -> Path:
    """A root with a small installation, others' files and traps among it, and a folder beside it."""
    root, outside = base / "root", base / "outside"
    outside.mkdir(parents=True)
    (outside / "file").write_text(THEIRS)
    put(root, FILES, LINKS, {})
    (root / "etc/passwd").write_text(THEIRS)
    (root / "etc/hil/rigs").mkdir()
    (root / "etc/hil/rigs/mine.toml").write_text(THEIRS)
    (root / "linked").symlink_to(outside)
    units = root / _UNITS
    (units / "hil-folder").mkdir()
    (units / "hil-linked").symlink_to(outside)
    (units / "hil-loop").symlink_to("hil-loop")
    os.mkfifo(units / "hil-pipe")
    return root


def _hostile(original: dict[str, str], chance: random.Random) -> bytes:
    if chance.random() < 0.1:
        return chance.choice(_BODIES).encode()
    entries = dict(original)
    ours = chance.random() < 0.5  # each might be of an installation, by its name
    for _ in range(chance.randint(1, 4)):
        name = "/".join(chance.choice(_PIECES) for _ in range(chance.randint(1, 4)))
        place = _UNITS + chance.choice(_OWN_NAMES) if ours else chance.choice(["", "", _UNITS]) + name
        entries[place] = chance.choice(_VALUES)
    return json.dumps(entries).encode()


def _there(folder: Path) -> dict[str, str]:
    """Every file, link and folder below, by its path, and what it says."""
    return {str(path.relative_to(folder)): _says(path) for path in folder.rglob("*")}


def _says(path: Path) -> str:
    if path.is_symlink():
        return os.readlink(path)
    return repr(path.read_bytes()) if path.is_file() else "folder or pipe"


def manifests(count: int, seed: int, base: Path) -> dict[str, int]:
    """Uninstall by so many manifests, each in a root of its own below `base`; how many were read and refused. Raises
    AssertionError for a file that is gone and was not ours, and whatever else the uninstall raises.
    """
    chance, counts = random.Random(seed), {"read": 0, "refused": 0}
    for number in range(count):
        root = _installed(base / str(number))
        original = read_manifest(root)
        whole = json.dumps(original, indent=1).encode()
        content = damaged(whole, chance) if number % 2 else _hostile(original, chance)
        (root / MANIFEST).write_bytes(content)
        before, beside = _there(root), _there(base / str(number) / "outside")
        try:
            remove_all(root, purge=False)
            counts["read"] += 1
            gone = set(before) - set(_there(root))
            ours = {*FILES, *LINKS, MANIFEST, f"{_UNITS}hil.target.wants"}
            assert gone <= ours | {f"{_UNITS}hil-loop"}, (number, content[:300], gone - ours)
        except InstallError as refusal:
            counts["refused"] += 1
            text = str(refusal)
            assert str(root / MANIFEST) in text, (number, text)
            assert len(text) < 2_000, (number, text[:300])
            assert text.isprintable(), (number, ascii(text[:300]))
            assert _there(root) == before, (number, content[:300])
        assert _there(base / str(number) / "outside") == beside, (number, content[:300])
    return counts
