"""Groups of commands of which only the one asked for is imported."""

import importlib
import inspect
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import typer


class Entry(NamedTuple):
    """Where a command lives, and its line of help. `target` ("module:name") names a function, or a typer.Typer with
    subcommands.
    """

    target: str
    help: str
    settings: dict[str, Any] | None = None  # click's context settings


def add_commands(
    group: typer.Typer, entries: Mapping[str, Entry], wanted: str | None, heading: str | None = None
) -> None:
    """Add every entry to a group: the one named `wanted` loaded, all others as lines of help below a heading."""
    for name, entry in entries.items():
        command: Callable[..., Any] | typer.Typer = load(entry.target) if name == wanted else _not_loaded
        if isinstance(command, typer.Typer):
            group.add_typer(command, name=name, help=entry.help, rich_help_panel=heading)
        else:
            text = entry.help if command is _not_loaded else _whole(entry.help, inspect.getdoc(command) or "")
            group.command(
                name, help=text, short_help=entry.help, context_settings=entry.settings, rich_help_panel=heading
            )(command)


def _whole(line: str, more: str) -> str:
    """A command's line, and what its function's docstring says besides, such as its exit statuses."""
    return more if more.startswith(line) else f"{line}.\n\n{more}".strip()


def first_word(words: list[str]) -> str | None:
    """The first argument that is no option."""
    return next((word for word in words if not word.startswith("-")), None)


def load(target: str) -> Any:
    """What "module:name" names."""
    module, _, name = target.partition(":")
    return getattr(importlib.import_module(module), name)


def _not_loaded() -> None:
    raise AssertionError("only the command asked for is loaded")
