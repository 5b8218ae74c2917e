"""Keys of earlier versions of the rig file: moved to where they are now, with a line each that says what to change."""

import sys
import warnings
from typing import Any

MOVED = ("brake", "watchdog_s")  # from [plant] to [drives]


class FormerKeyWarning(FutureWarning):
    """A rig file has a key of an earlier version; the text says what to write instead."""


class FormerKeyError(ValueError):
    """A rig file states a former key and the present one, and they differ; the text says which to remove."""


def show_former_keys() -> None:
    """From now on this process prints a FormerKeyWarning as one line on stderr; other warnings as before."""
    warnings.showwarning = _show_warning


def _show_warning(
    message: Warning | str, category: type[Warning], filename: str, lineno: int, file: Any = None, line: Any = None
) -> None:
    """What a rig file of an earlier version should say instead, as a line like any other; other warnings as ever."""
    plain = f"hil: {message}\n"
    other = warnings.formatwarning(message, category, filename, lineno, line)
    (file or sys.stderr).write(plain if issubclass(category, FormerKeyWarning) else other)


def modernise(document: dict[str, Any]) -> list[str]:
    """Move former keys of a parsed rig document, in place. Returns a line for each.

    plant.watchdog_s and plant.brake are drives.watchdog_s and drives.brake. axes.NAME.safe, which nothing acted on,
    gives way to either brake, and is drives.brake where the document has neither. telemetry.ring_slots goes. Raises
    FormerKeyError.
    """
    plant, axes = document.get("plant"), document.get("axes")
    drives = document.get("drives", {})
    if not isinstance(drives, dict):
        return []  # which the schema refuses
    lines = [
        _move(drives, f"plant.{name}", name, plant.pop(name))
        for name in MOVED
        if isinstance(plant, dict) and name in plant
    ]
    tables = {name: axis for name, axis in axes.items() if isinstance(axis, dict)} if isinstance(axes, dict) else {}
    safe = {name: axis.pop("safe") for name, axis in tables.items() if "safe" in axis}
    if safe:
        held = [safe.get(name) == "brake" for name in tables]
        brake = drives.setdefault("brake", held if any(held) else False)
        lines.append(_line(", ".join(f"axes.{name}.safe" for name in safe), "brake", brake))
    if lines:
        document["drives"] = drives
    telemetry = document.get("telemetry")
    if isinstance(telemetry, dict) and telemetry.pop("ring_slots", None) is not None:
        lines.append("telemetry.ring_slots: the ring holds telemetry.blackbox_s seconds of ticks; remove ring_slots")
    return lines


def _move(drives: dict[str, Any], former: str, name: str, value: Any) -> str:
    if drives.setdefault(name, value) != value:
        raise FormerKeyError(
            f"{former} = {_toml(value)}: what the drives have is stated in [drives], where drives.{name} = "
            f"{_toml(drives[name])}; remove {former}"
        )
    return _line(former, name, value)


def _line(former: str, name: str, value: Any) -> str:
    return f"{former}: what the drives have is stated in [drives]; write drives.{name} = {_toml(value)} instead"


def _toml(value: Any) -> str:
    from drivers.base.toml_file import shown  # which every command would load

    return shown(value).lower() if isinstance(value, bool | list) else shown(value)
