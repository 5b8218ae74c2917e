"""[[plant.modes]] and [[plant.slip]]: what rings on an emulated axis, and the elements its friction slips by."""

from collections.abc import Sequence
from typing import Annotated, Final

from pydantic import Field

from drivers.base.keys import REQUIRED, Table, key

MOST_LOAD: Final = 0.95  # of an axis' mass, on springs
MOST_MODES: Final = 3  # of an axis
MOST_SLIPS: Final = 4
Share = Annotated[float, Field(ge=1e-3, le=1e3)]


class ModeConfig(Table):
    """[[plant.modes]]: a mass on a spring beside the motor, which the encoder sees (physics/dynamics.py)."""

    axis: str | None = key(None, "axis that rings; without: every axis that has no entry of its own")
    frequency_hz: float = key(
        REQUIRED,
        "at which it rings while the motor is held; 1/sqrt(1 - load) times that while it is free, where it is alone",
        "Hz",
        ge=1,
        le=5000,
    )
    damping: float = key(0.02, "its damping ratio on the held motor", "1", ge=0, le=1)
    load: float = key(
        0.3,
        f"its fraction of the moving mass; those of an axis together: at most {MOST_LOAD}",
        "1",
        ge=0.001,
        le=MOST_LOAD,
    )
    tool: bool = key(
        True,
        f"whether it carries the tool, where no entry of the axis before it does; else it only rings, as at most "
        f"{MOST_MODES - 1} of an axis may",
        exclude_if=lambda tool: tool,
    )


class SlipConfig(Table):
    """[[plant.slip]]: Maxwell-slip friction, a spring that slips at its limit, in place of the LuGre bristle.

    An axis' elements together have its Coulomb friction, and at rest the stiffness coulomb / presliding.
    """

    axis: str | None = key(None, "axis that has it; without: every axis that has no entry of its own")
    stiffness: Share = key(1.0, "its stiffness, in proportion to the axis' other elements", "1")
    limit: Share = key(1.0, "force at which it slips, in proportion to the axis' other elements", "1")


def modes_fit(modes: Sequence[ModeConfig]) -> None:
    """Raises ValueError where an axis has more of them without a tool than may be, or too much of its mass on them."""
    for axis in dict.fromkeys(mode.axis for mode in modes):
        own, name = [mode for mode in modes if mode.axis == axis], axis or "(every)"
        if len(own) == MOST_MODES and not any(mode.tool for mode in own):
            raise ValueError(f"modes: {MOST_MODES} on axis {name} have tool = false; allowed: {MOST_MODES - 1}")
        load = sum(mode.load for mode in own)
        if load > MOST_LOAD + 1e-9:
            raise ValueError(f"modes: load of axis {name} is {load:.6g} together; allowed: at most {MOST_LOAD}")


def slip_fits(elements: Sequence[SlipConfig], presliding: Sequence[float], names: Sequence[str]) -> None:
    """Raises ValueError where an axis of `names` (any number: none has a name) has elements and no presliding."""
    named = {element.axis for element in elements}
    for number, length in enumerate(presliding):
        name = names[number] if names else number
        if not length and (name in named or None in named):
            raise ValueError(f"plant.slip: axis {name} has plant.presliding = 0; expected above 0 for its elements")
