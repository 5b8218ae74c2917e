"""Configuration files in TOML: read within stated limits of size and nesting; and values as a refusal shows them."""

import json
import os
import re
import tomllib
from collections.abc import Callable, Sequence
from typing import Any

from drivers.base.text_file import UnsuitableFileError, printable, read_bounded

LARGEST = 2**18  # bytes; the longest rig file we know has 8 kB
DEEPEST = 32  # points in the keys of one line; tomllib takes a time that grows with their square
MOST_PROBLEMS = 50  # shown of one file
_SHOWN = 120  # characters of a value in a refusal
_STRING = re.compile(r""" "(?:[^"\\]|\\.)*" | '[^']*' """, re.VERBOSE)  # on one line
_BARE = re.compile(r"[A-Za-z0-9_-]+")  # a key that needs no quotes
_DECIMAL = re.compile(r"(?<![\w.])\d[\d_]*\.\d[\d_]*(?:[eE][+-]?\d+)?(?![\w.])")


class TomlError(ValueError):
    """The bytes are no TOML document; the text says why."""


def read_toml(path: str | os.PathLike[str]) -> dict[str, Any]:
    """The document in a file. Raises OSError where it cannot be read, TomlError where it is none."""
    try:
        data = read_bounded(path, LARGEST)
    except UnsuitableFileError as error:
        raise TomlError(f"not a TOML document: {error}") from None
    if data.startswith(b"\xef\xbb\xbf"):
        raise TomlError("not a TOML document: begins with a byte order mark; save it as UTF-8 without one")
    try:
        return parse_toml(data.decode())
    except UnicodeDecodeError as error:
        raise TomlError(f"not a TOML document: {error}") from None


def parse_toml(text: str) -> dict[str, Any]:
    """The document in a text. Raises TomlError."""
    _refuse_deep_keys(text)
    try:
        return tomllib.loads(text)
    except RecursionError:
        raise TomlError("not a TOML document we can read: nested too deeply") from None
    except ValueError as error:  # tomllib's own, and what Python says of a number with thousands of digits
        raise TomlError(f"not a TOML document: {error}") from None


def _refuse_deep_keys(text: str) -> None:
    """Raise TomlError for a line whose keys may be nested too deeply: points in no string and no decimal number."""
    for number, line in enumerate(text.split("\n"), start=1):
        if line.count(".") <= DEEPEST or line.lstrip(" \t").startswith("#"):
            continue
        if _DECIMAL.sub("", _STRING.sub('""', line)).count(".") > DEEPEST:
            raise TomlError(f"not a TOML document we can read: line {number}: nested too deeply: over {DEEPEST} points")


def toml_value(value: Any) -> str:
    """A value as TOML writes it on one line: tables inline, keys whose value is None left out."""
    if isinstance(value, dict):
        return "{" + ", ".join(_pairs(value)) + "}"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(map(toml_value, value)) + "]"
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False)
    return str(value).lower() if isinstance(value, bool) else repr(value)


def toml_text(document: dict[str, Any]) -> str:
    """A document as TOML, a line for each of its keys."""
    return "".join(f"{pair}\n" for pair in _pairs(document))


def _pairs(table: dict[str, Any]) -> list[str]:
    return [
        f"{key if _BARE.fullmatch(key) else json.dumps(key, ensure_ascii=False)} = {toml_value(value)}"
        for key, value in table.items()
        if value is not None
    ]


def shown(value: Any) -> str:
    """A value as a refusal shows it: like repr, but short, whatever it is."""
    try:
        text = repr(value)
    except ValueError:  # a number of thousands of digits, which TOML can write in hexadecimal
        return "a number of thousands of digits"
    except RecursionError:
        return "tables or lists in one another, hundreds deep"
    return short(text)


def short(text: str, most: int = _SHOWN) -> str:
    """The beginning of a text that may be of any length and say anything, as a terminal may see it."""
    return printable(text if len(text) <= most else f"{text[:most]}...")


def own_words(message: str) -> str:
    """A check's own words, without those that pydantic puts before them."""
    return message.removeprefix("Value error, ")


def first_problems(problems: Sequence[Any], line: Callable[[Any], str]) -> list[str]:
    """As many problems of a file as somebody reads, a line each, and how many more there are."""
    left_out = len(problems) - MOST_PROBLEMS
    lines = [line(problem) for problem in problems[:MOST_PROBLEMS]]
    return [*lines, f"and {left_out} more problems"] if left_out > 0 else lines
