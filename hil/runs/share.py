"""`hil share RUN`: a run as one file for somebody else, which says what is in it and holds no code unasked."""

import os
import re
import sys
import tempfile
import time
import zipfile
from collections.abc import Iterator
from importlib.metadata import version
from pathlib import Path
from typing import Annotated, NamedTuple

import typer

from drivers.base.text_file import UnsuitableFileError, open_untrusted, printable, words_of
from hil.cli.exit_status import EXIT_FILE
from hil.runs.last import named_or_last
from hil.runs.without_code import carried_sources, copy_without_code, files_of
from hil.telemetry.mcap_items import LARGEST_FILE
from hil.telemetry.recording import RecordingError

_DATA = re.compile(r"summary\.json|.*\.note\.json|.*\.png")  # beside recordings: they hold figures and words, no code
_MODE = 0o640
_INSIDE = "INSIDE.txt"


class Item(NamedTuple):
    """A file of a run. said: what it holds, or why it is left out. copied: a recording that is copied without code."""

    path: Path
    said: str
    inside: bool
    copied: bool = False


def share(
    run: Annotated[
        Path | None, typer.Argument(metavar="RUN", help="folder of a run, or a recording; default: the last one")
    ] = None,
    out: Annotated[Path | None, typer.Option("--out", "-o", help="the new file [RUN.zip]")] = None,
    with_code: Annotated[
        bool, typer.Option("--with-code", help="the source of laws and plug-ins, logs and all other files, too")
    ] = False,
    only_list: Annotated[bool, typer.Option("--list", help="say what would be inside, and write nothing")] = False,
) -> None:
    """Pack a run into one zip file for somebody else, and say first what is inside.

    The source of laws and other plug-ins is left out unless --with-code asks for it. Without it, such a run can be
    looked at, but not replayed. A file that is there already is not replaced.

    Exit status 74: a file cannot be read or written.
    """
    named = named_or_last(run)
    target = out or Path(f"{_safe(named.resolve().name.removesuffix('.mcap'))}.zip")
    items = list(_items(named, with_code=with_code))
    lines = list(_lines(items))
    print("\n".join(lines))
    try:
        if not any(item.inside for item in items):
            raise RecordingError(f"{named}: nothing to share")
        if only_list:
            return
        _write(target, _safe(named.resolve().name.removesuffix(".mcap")), items, "\n".join(lines))
    except (RecordingError, UnsuitableFileError) as error:
        print(printable(f"hil share: {error}"), file=sys.stderr)
        raise typer.Exit(EXIT_FILE) from None
    print(printable(f"{target}: {target.stat().st_size / 1e6:.3f} MB"))


def _items(named: Path, *, with_code: bool) -> Iterator[Item]:
    """What there is of a run, in the order of names. Raises OSError."""
    paths = sorted(named.iterdir()) if named.is_dir() else [named]
    for path in paths:
        if path.is_symlink() and path != named:
            yield Item(path, "a link", False)
        elif not path.is_file():
            yield Item(path, "not a file", False)
        elif path.suffix == ".mcap":
            yield _recording(path, with_code=with_code)
        elif with_code:
            yield Item(path, "as it is", True)
        elif _DATA.fullmatch(path.name):
            yield Item(path, "figures or notes", True)
        else:
            yield Item(path, "may hold code or names of this computer; --with-code takes it", False)


def _recording(path: Path, *, with_code: bool) -> Item:
    try:
        found, whole = carried_sources(path)
    except RecordingError as error:
        said = str(error).removeprefix(f"{path}: ")
        return Item(path, said if with_code else f"{said}; --with-code takes it", with_code)
    except OSError as error:
        return Item(path, words_of(error), False)
    keys = ", ".join(sorted(found))
    files = "".join(f", the text of {name}" for name in files_of(path))
    said = f"a recording: rig{files}, ticks, commands with who gave them, events, this computer's kernel"
    if found and with_code:
        return Item(path, f"{said}, and the source of {keys}", True)
    left = f"; the source of {keys} is left out" if found else ""
    damaged = "; damaged, only what is whole of it" if not whole and not with_code else ""
    return Item(path, f"{said}{left}{damaged}", True, copied=not with_code)


def _lines(items: list[Item]) -> Iterator[str]:
    for inside, title in ((True, "inside:"), (False, "left out:")):
        chosen = [item for item in items if item.inside is inside]
        if chosen:
            yield title
            yield from (printable(f"  {item.path.name}: {item.said}").replace("\n", " ") for item in chosen)


def _write(target: Path, folder: str, items: list[Item], told: str) -> None:
    """A new zip file, which is gone again where anything fails. Raises OSError, RecordingError, UnsuitableFileError."""
    flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC
    descriptor = os.open(target, flags, _MODE)
    try:
        with os.fdopen(descriptor, "wb") as file, zipfile.ZipFile(file, "w") as packed:
            packed.writestr(zipfile.ZipInfo(f"{folder}/{_INSIDE}"), f"shared by hil {version('hil')}\n{told}\n")
            for item in items:
                if item.inside:
                    _add(packed, folder, item)
    except BaseException:
        target.unlink(missing_ok=True)
        raise


def _add(packed: zipfile.ZipFile, folder: str, item: Item) -> None:
    with tempfile.TemporaryDirectory(prefix="hil-share-") as scratch:
        source = item.path
        if item.copied:
            source = Path(scratch) / "copy.mcap"
            copy_without_code(item.path, source)
        date = max(time.gmtime(item.path.stat().st_mtime)[:6], (1980, 1, 1, 0, 0, 0))  # zip knows none before
        entry = zipfile.ZipInfo(f"{folder}/{_safe(item.path.name)}", date)
        entry.external_attr = (0o100000 | _MODE) << 16
        stored = item.path.suffix in (".mcap", ".png")  # which are compressed
        entry.compress_type = zipfile.ZIP_STORED if stored else zipfile.ZIP_DEFLATED
        with open_untrusted(source, LARGEST_FILE) as file, packed.open(entry, "w", force_zip64=True) as inside:
            while block := file.read(2**20):
                inside.write(block)


def _safe(name: str) -> str:
    """A name for a file in an archive that any computer takes."""
    return re.sub(r"[^A-Za-z0-9._-]|^\.+", "_", name) or "run"
