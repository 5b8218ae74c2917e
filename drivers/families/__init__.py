"""Drives by family. A folder in here is a family: its module `family` declares it, as FAMILY, and nothing lists it.

A family has the frame layouts of its drives, its keys of [bus], the rig file that `hil new` writes for it, and its
contracts (EDS, DBC). Whatever else is to know of it asks this declaration. Functions and classes stand in it as
`package.module:Name`: a rig loads no family but its own.
"""

from collections.abc import Mapping, Sequence
from functools import cache
from importlib import import_module
from pkgutil import iter_modules
from typing import TYPE_CHECKING, Any, NamedTuple

if TYPE_CHECKING:  # hil.cycle.gate loads this too, and needs none of it
    from pydantic import BaseModel


class Sides(NamedTuple):
    """The two sides of a frame layout, each a class that is made with the rig's `Wiring` (drivers/config.py).

    plain: torques are floats, every drive samples at the command and answers with what it read: what a batch of plants
    computes without a bus (`hil sweep`).
    """

    host: str
    drives: str
    plain: bool = False


class Family(NamedTuple):
    """What a folder of drives declares.

    layouts: by the name that bus.protocol has for each; NAME:FILE takes a file beside the rig. keys: those it adds to
    [bus]; a table among them is None where the rig has none. canopen: its drives are nodes of CANopen.

    Functions by name, empty where there is nothing to say:

    - cut(bus, n_axes): what another segment of the rig has otherwise, by the axes on it. Empty: its drives are on one.
    - problems(circumstances): what else of a rig does not go with its drives, a line each.
    - reader(bus, base_dir, cyclic): frames in words; cyclic: what words there are for samples and commands.
    - sketch(name, axes, watchdog_s): what `hil new` writes for such drives, as a `Sketched`.

    order: of its layouts among all; the first layout of the first family is that of a rig which names none.
    """

    layouts: Mapping[str, Sides]
    keys: "type[BaseModel]"
    canopen: bool = False
    cut: str = ""
    problems: str = ""
    reader: str = ""
    sketch: str = ""
    order: int = 1


class Circumstances(NamedTuple):
    """What a family may look at in a rig. speeds: limits.speed of each axis by name, per s; steps: its encoder's
    resolution. disable_s: within which a drive has to say that it is disabled.
    """

    bus: Any
    period_s: float
    rate_hz: float
    watchdog_s: float
    disable_ticks: int
    speeds: Mapping[str, float]
    steps: Mapping[str, float]


class SketchedAxis(NamedTuple):
    """What `hil new` knows of an axis, m (rad), N (N m). encoder: per count. force: its drive's rated one. travel: from
    end to end.
    """

    name: str
    encoder: float
    force: float
    travel: float


class Sketched(NamedTuple):
    """What a family adds to a new rig file. tables: TOML below [bus]. axes: a line of each axis' table, or none. file:
    text of the file that NAME:FILE takes, and its ending.
    """

    tables: str = ""
    axes: Sequence[str] = ()
    file: str = ""
    ending: str = ""
    encoders: Sequence[float] = ()


@cache
def families() -> dict[str, Family]:
    """Every family by the name of its folder, in their order."""
    found: dict[str, Family] = {}
    for name in sorted(module.name for module in iter_modules(__path__) if module.ispkg):
        found[name] = import_module(f"{__name__}.{name}.family").FAMILY
    return dict(sorted(found.items(), key=lambda item: item[1].order))


def layouts() -> dict[str, Sides]:
    """The sides of every layout, by the name that a rig gives it."""
    return {name: sides for family in families().values() for name, sides in family.layouts.items()}


def family_of(protocol: str) -> Family | None:
    """The family of a layout, by bus.protocol; None for a layout of users."""
    return next((family for family in families().values() if _listed(protocol) in family.layouts), None)


def sides_of(protocol: str) -> Sides | None:
    """The two sides of a layout, by bus.protocol; None for a layout of users."""
    return layouts().get(_listed(protocol))


def _listed(protocol: str) -> str:
    name, colon, _ = protocol.partition(":")
    return f"{name}:FILE" if colon else name
