"""What one rig says otherwise than another."""

from collections.abc import Iterator
from typing import Any

from drivers.base.toml_file import shown
from hil.rig.schema import RigConfig


def rig_differences(first: RigConfig, second: RigConfig) -> list[str]:
    """A line for every key with another value: "law.name: 'pid', 'robust-pd'"; "-" stands for a key not there."""
    one, other = (dict(_leaves(rig.model_dump(mode="json"), "")) for rig in (first, second))
    found = []
    for path in dict.fromkeys((*one, *other)):
        if path not in one or path not in other or one[path] != other[path]:
            found.append(f"{path}: " + ", ".join(shown(side[path]) if path in side else "-" for side in (one, other)))
    return found


def _leaves(value: Any, path: str) -> Iterator[tuple[str, Any]]:
    if isinstance(value, dict) and value:
        for key, item in value.items():
            yield from _leaves(item, f"{path}.{key}" if path else key)
    else:
        yield path, value
