"""Code that a recording carries: what it is, and whether this user has trusted it before.

A recording is data. Its rig may name a law, an estimator or a frame layout of a user's; nobody who reads a recording
runs them unasked. What may run is known by the digest of its text: a name or a hash in the file proves nothing, as
the file's author writes them too.
"""

import contextlib
import os
from pathlib import Path
from typing import NamedTuple

from drivers.base.plugins import code_digest
from drivers.base.text_file import UnsuitableFileError, read_bounded
from drivers.config import LAYOUT_KIND
from drivers.sensors.config import sensor_kind
from hil.rig import law_names
from hil.rig.motion_tables import MOTION_KIND
from hil.rig.schema import RigConfig
from hil.rig.tables import ESTIMATOR_KIND

_KINDS = (law_names.KIND, ESTIMATOR_KIND, MOTION_KIND, LAYOUT_KIND)  # tasks and stages do not run in a replay
_LARGEST = 2**20  # bytes of the file of trusted digests


class Code(NamedTuple):
    """A plug-in of a rig. key: of the rig, such as law.name. digest: as drivers.base.plugins.code_digest."""

    key: str
    name: str
    digest: str

    @property
    def text(self) -> str:
        """For people: what would run."""
        return f"{self.key} = {self.name!a:.80} ({self.digest[:19]})"


def carried_code(rig: RigConfig) -> list[Code]:
    """What a control cycle of this rig runs that is not ours."""
    tables = [(kind, getattr(rig, kind.table)) for kind in _KINDS]
    tables += [(sensor_kind(name), sensor) for name, sensor in rig.sensors.items()]
    found = []
    for kind, table in tables:
        name = getattr(table, kind.key)
        if name and not kind.own(name):
            found.append(Code(kind.path, name, code_digest(name, table.source)))
    return found


def trusted_file() -> Path:
    """Where the digests stand that this user trusts, one a line: $XDG_CONFIG_HOME/hil/trusted-code."""
    base = os.environ.get("XDG_CONFIG_HOME") or os.path.expanduser("~/.config")
    return Path(base) / "hil" / "trusted-code"


def trusted() -> frozenset[str]:
    """The digests that this user trusts; none where the file cannot be read, or others may write to it."""
    path = trusted_file()
    with contextlib.suppress(OSError, UnsuitableFileError, UnicodeDecodeError):
        found = path.stat()
        if found.st_uid == os.geteuid() and not found.st_mode & 0o022:
            return frozenset(read_bounded(path, _LARGEST).decode().split())
    return frozenset()


def trust(found: list[Code]) -> Path:
    """From now on these are trusted, where they have a digest; returns the file that says so. Raises OSError."""
    path, known = trusted_file(), trusted()
    path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
    descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND | os.O_CLOEXEC | os.O_NOFOLLOW, 0o600)
    with os.fdopen(descriptor, "a") as file:
        file.writelines(f"{code.digest}\n" for code in found if code.digest != code.name and code.digest not in known)
    return path
