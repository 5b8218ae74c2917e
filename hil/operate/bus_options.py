"""The bus that a command's options name, where no rig file does."""

import contextlib
import json
from collections.abc import Sequence
from typing import Annotated

import typer
from pydantic import ValidationError

from drivers.base.toml_file import own_words
from drivers.config import BusConfig, Option

InterfaceOption = Annotated[
    str, typer.Option("--interface", "-i", help="auto: SocketCAN where it exists; or any interface of python-can")
]
BitrateOption = Annotated[int, typer.Option("--bitrate", help="bit/s, for interfaces that are set up here")]
OptionsOption = Annotated[
    list[str] | None, typer.Option("--option", metavar="KEY=VALUE", help="of the interface, as ttyBaudrate=115200")
]


def stated_bus(channel: str, interface: str, bitrate: int = 1_000_000, options: Sequence[str] = ()) -> BusConfig:
    """A bus by options; `options` are KEY=VALUE, of a python-can interface. Raises typer.BadParameter."""
    stated: dict[str, Option] = {}
    for option in options:
        name, equals, value = option.partition("=")
        if not equals:
            raise typer.BadParameter(f"{option!r}: KEY=VALUE is needed", param_hint="--option")
        stated[name] = _value(value)
    try:
        return BusConfig(channel=channel, interface=interface, bitrate=bitrate, options=stated)
    except ValidationError as error:
        raise typer.BadParameter(invalid_words(error)) from None


def _value(text: str) -> Option:
    """A number, true or false, else the text as it is."""
    with contextlib.suppress(ValueError):
        value = json.loads(text)
        if isinstance(value, bool | int | float):
            return value
    return text


def invalid_words(error: ValidationError) -> str:
    """What is wrong with options that make a table, for people."""
    words = []
    for problem in error.errors():
        place = ".".join(str(part) for part in problem["loc"])
        text = own_words(problem["msg"])
        words.append(f"{place} = {problem['input']!r}: {text}" if place else text)
    return "; ".join(words)
