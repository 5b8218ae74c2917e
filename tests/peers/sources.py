"""Peers' sources and tools, from the package registry at the time of the run, kept in build/peers; none is committed.

sources.lock has the source archives, with their hashes, of the versions that requirements.lock installs;
requirements.lock beside it what else runs: their tests' own needs, and programs that ours are held against.
"""

import hashlib
import importlib
import re
import shutil
import subprocess
import sys
import tarfile
from functools import cache
from pathlib import Path
from typing import Any

from tests.support.paths import ROOT

HERE = Path(__file__).parent
FOLDER = ROOT / "build" / "peers"
PATIENCE_S = 300.0
_PINNED = re.compile(r"^(\S+)==(\S+) --hash=sha256:([0-9a-f]{64})$", re.MULTILINE)


class UnavailableError(Exception):
    """The registry does not give it; the text says why, in one line."""


def pinned() -> dict[str, tuple[str, str]]:
    """Version and sha256 of each source archive."""
    return {name: (version, digest) for name, version, digest in _PINNED.findall((HERE / "sources.lock").read_text())}


@cache
def source(name: str) -> Path:
    """The unpacked source archive of a package. Raises UnavailableError."""
    version, digest = pinned()[name]
    folder = FOLDER / f"{name}-{version}"
    if not folder.is_dir():
        archives = FOLDER / "archives" / name
        shutil.rmtree(archives, ignore_errors=True)
        _pip("download", "--no-deps", "--no-binary", ":all:", "--dest", str(archives), f"{name}=={version}")
        (archive,) = archives.glob("*.tar.gz")
        found = hashlib.sha256(archive.read_bytes()).hexdigest()
        if found != digest:
            raise UnavailableError(f"{archive.name} has sha256 {found}, not {digest} as in sources.lock")
        _unpack(archive, folder)
    return folder


def _unpack(archive: Path, folder: Path) -> None:
    making = folder.with_suffix(".making")
    shutil.rmtree(making, ignore_errors=True)
    with tarfile.open(archive) as tar:
        tar.extractall(making, filter="data")
    (top,) = making.iterdir()
    top.rename(folder)
    making.rmdir()


@cache
def tools() -> Path:
    """A folder to import tools from. Raises UnavailableError."""
    lock = HERE / "requirements.lock"
    folder = FOLDER / f"lib-{hashlib.sha256(lock.read_bytes()).hexdigest()[:12]}"
    if not folder.is_dir():
        making = folder.with_suffix(".making")
        shutil.rmtree(making, ignore_errors=True)
        _pip("install", "--require-hashes", "--no-deps", "--target", str(making), "-r", str(lock))
        making.rename(folder)
    return folder


def tool(name: str) -> Any:
    """A module of the tools' folder, which comes behind our own packages. Raises UnavailableError."""
    folder = str(tools())
    if folder not in sys.path:
        sys.path.append(folder)
    return importlib.import_module(name)


def _pip(*words: str) -> None:
    command = [sys.executable, "-m", "pip", *words, "--quiet", "--disable-pip-version-check", "--retries", "1"]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE_S, check=False)
    except subprocess.TimeoutExpired:
        raise UnavailableError(f"no answer from the registry in {PATIENCE_S:g} s") from None
    if done.returncode:
        said = [line for line in done.stderr.splitlines() if line.startswith("ERROR")]
        raise UnavailableError((said or [done.stderr.strip()[-200:]])[0])
