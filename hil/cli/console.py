"""The terminal as commands write to it."""

from typing import Any

from rich.console import Console


def plain_console(**options: Any) -> Console:
    """rich's console, with its options, that leaves text as it is: rich makes a picture of ":x:", as in ./mine.py:x."""
    return Console(emoji=False, **options)
