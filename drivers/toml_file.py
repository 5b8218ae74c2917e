"""Configuration files: read whole, but never more than such a file can be; and values as a refusal shows them."""

import os
import tomllib
from pathlib import Path
from typing import Any

LARGEST = 2**20  # bytes; the longest rig file we know has 8 kB, and /dev/zero has no end
_SHOWN = 120  # characters of a value in a refusal


class TomlError(ValueError):
    """The bytes are no TOML document; the text says why."""


def read_toml(path: str | os.PathLike[str]) -> dict[str, Any]:
    """The document in a file. Raises OSError where it cannot be read, TomlError where it is none."""
    with Path(path).open("rb") as file:
        data = file.read(LARGEST + 1)
    if len(data) > LARGEST:
        raise TomlError(f"not a TOML document: longer than {LARGEST} bytes")
    if data.startswith(b"\xef\xbb\xbf"):
        raise TomlError("not a TOML document: begins with a byte order mark; save it as UTF-8 without one")
    try:
        return parse_toml(data.decode())
    except UnicodeDecodeError as error:
        raise TomlError(f"not a TOML document: {error}") from None


def parse_toml(text: str) -> dict[str, Any]:
    """The document in a text. Raises TomlError."""
    try:
        return tomllib.loads(text)
    except RecursionError:
        raise TomlError("not a TOML document we can read: nested too deeply") from None
    except ValueError as error:  # tomllib's own, and what Python says of a number with thousands of digits
        raise TomlError(f"not a TOML document: {error}") from None


def shown(value: Any) -> str:
    """A value as a refusal shows it: like repr, but short, whatever it is."""
    try:
        text = repr(value)
    except ValueError:  # a number of thousands of digits, which TOML can write in hexadecimal
        return "a number of thousands of digits"
    return short(text)


def short(text: str) -> str:
    """The beginning of a text that may be of any length."""
    return text if len(text) <= _SHOWN else f"{text[:_SHOWN]}..."
