"""Who may see and do what: one-time codes, and the browsers that were paired by them.

    FOLDER/codes-PORT      one code a role, each good once; readable by the owner and the group of the folder
    FOLDER/pairings.json   name, role and SHA-256 of the secret of every paired browser; the owner's alone

A browser that gives a code gets a secret of 256 bits, which it shows with every request (a cookie). Both files are
looked at again when they change, so that `hil page --revoke NAME` counts at once.
"""

import contextlib
import fcntl
import hashlib
import hmac
import json
import os
import secrets
import time
from collections.abc import Iterator
from enum import IntEnum
from pathlib import Path
from typing import Final, NamedTuple

from drivers.base.runtime import open_private, read_private, write_private
from drivers.base.toml_file import short

_LETTERS: Final = "ABCDEFGHJKMNPQRSTUVWXYZ23456789"  # none that is taken for another
_LENGTH: Final = 8  # 31^8: 8.5e11 codes
WRONG: Final = 5  # guesses, after which all codes are new and nobody is paired for LOCKED_S
LOCKED_S: Final = 30.0
MOST: Final = 100  # pairings
_LONGEST_NAME: Final = 40


class Role(IntEnum):
    """What a paired browser may do; each may what those before may."""

    WATCH = 1
    STOP = 2  # E-STOP and the damped stop
    OPERATE = 3  # reset a latched fault


class Pairing(NamedTuple):
    """A browser. digest: SHA-256 of its secret, hex. wall: when it was paired, s since 1970."""

    name: str
    role: Role
    digest: str
    wall: float


class PairingError(Exception):
    """A code that is none, or a file that cannot be used; the text says what to do."""


class Access:
    """The codes and pairings in a folder, which is made. port: of the page that gives the codes. Raises OSError."""

    def __init__(self, folder: Path, port: int = 0) -> None:
        self.folder, self._port = folder, port
        folder.mkdir(mode=0o750, parents=True, exist_ok=True)
        self._pairings: dict[tuple[int, int], list[Pairing]] = {}  # by the stamp of the file that they are from
        self._wrong, self._locked_s = 0, float("-inf")
        self.codes: dict[Role, str] = {}

    @property
    def codes_file(self) -> Path:
        """Where the codes are."""
        return self.folder / f"codes-{self._port}"

    def renew(self, role: Role | None = None) -> None:
        """A new code for that role, or for all."""
        for each in Role if role is None else (role,):
            self.codes[each] = "".join(secrets.choice(_LETTERS) for _ in range(_LENGTH))
        lines = [f"{each.name.lower():8} {spelt(code)}\n" for each, code in self.codes.items()]
        write_private(self.codes_file, "".join(lines))
        self.codes_file.chmod(0o640)

    def pair(self, code: str, name: str, now_s: float | None = None) -> tuple[str, Pairing]:
        """Pair a browser: its secret, and what it may. name: its user's word for it. Raises PairingError, OSError."""
        now_s = time.monotonic() if now_s is None else now_s
        if now_s < self._locked_s:
            raise PairingError(f"too many wrong codes: wait {self._locked_s - now_s:.0f} s, then take a new code")
        given = "".join(letter for letter in code.upper() if letter in _LETTERS).encode()
        found = [role for role, valid in self.codes.items() if hmac.compare_digest(valid.encode(), given)]
        if not found:
            self._wrong += 1
            if self._wrong >= WRONG:
                self._wrong, self._locked_s = 0, now_s + LOCKED_S
                self.renew()
            raise PairingError(f"no such code: read the codes on the rig's machine, cat {self.codes_file}")
        self._wrong = 0
        role, *_ = found
        secret, pairing = self.admit(name, role)
        self.renew(role)
        return secret, pairing

    def admit(self, name: str, role: Role) -> tuple[str, Pairing]:
        """Pair without a code, as the owner of the folder may: a program's secret. Raises PairingError, OSError."""
        secret = secrets.token_urlsafe(32)
        with self._locked():
            known = self.pairings()
            if len(known) >= MOST:
                raise PairingError(f"{MOST} browsers are paired: revoke one, hil page --revoke NAME")
            pairing = Pairing(_free_name(name, known), role, _digest(secret), time.time())
            self._write([*known, pairing])
        return secret, pairing

    def pairing_of(self, secret: str | None) -> Pairing | None:
        """Whose secret that is; None: nobody's, or it was revoked."""
        if not secret:
            return None
        digest = _digest(secret)
        return next((each for each in self.pairings() if hmac.compare_digest(each.digest, digest)), None)

    def pairings(self) -> list[Pairing]:
        """All of them, read again where the file has changed; none where it cannot be read."""
        try:
            found = self._file.stat()
        except OSError:
            return []
        stamp = found.st_mtime_ns, found.st_ino
        if stamp not in self._pairings:
            self._pairings = {stamp: self._read()}
        return self._pairings[stamp]

    def revoke(self, name: str) -> bool:
        """Take a browser's rights away; False where none has that name. Raises OSError."""
        with self._locked():
            known = self.pairings()
            kept = [each for each in known if each.name != name]
            if len(kept) == len(known):
                return False
            self._write(kept)
        return True

    @property
    def _file(self) -> Path:
        return self.folder / "pairings.json"

    def _read(self) -> list[Pairing]:
        with contextlib.suppress(OSError, ValueError, TypeError, KeyError):
            rows = json.loads(read_private(self._file))
            return [
                Pairing(str(row["name"]), Role(row["role"]), str(row["digest"]), float(row["wall"])) for row in rows
            ]
        return []

    def _write(self, pairings: list[Pairing]) -> None:
        write_private(self._file, json.dumps([each._asdict() for each in pairings]))

    @contextlib.contextmanager
    def _locked(self) -> Iterator[None]:
        """One at a time: a revocation must not be lost beside a pairing."""
        with open(open_private(self.folder / "pairings.lock", os.O_RDWR | os.O_CREAT), "rb") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            yield


def spelt(code: str) -> str:
    """A code as people read it."""
    return f"{code[: _LENGTH // 2]}-{code[_LENGTH // 2 :]}"


def _digest(secret: str) -> str:
    return hashlib.sha256(secret.encode()).hexdigest()


def _free_name(wanted: str, known: list[Pairing]) -> str:
    base = short(wanted.strip(), _LONGEST_NAME).replace("\n", " ") or "browser"
    taken = {each.name for each in known}
    return next(
        name for number in range(1, MOST + 2) if (name := f"{base} {number}" if number > 1 else base) not in taken
    )
