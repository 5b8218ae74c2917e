"""`hil diff` of two rig files that `hil identify` wrote: what a stage has become since."""

from typing import Any, NamedTuple

from rich.console import Console
from rich.table import Table

from hil.rig.measured_table import MeasuredConfig, changed
from hil.rig.schema import RigConfig, RigError


class Trend(NamedTuple):
    """A quantity of an axis in both files: value and half width, SI."""

    axis: str
    quantity: str
    first: list[float]
    second: list[float]

    @property
    def left(self) -> bool:
        """Whether the second value is beyond both intervals."""
        return bool(changed(MeasuredConfig.model_validate({self.quantity: self.first}), {self.quantity: self.second}))


def trends(first: RigConfig, second: RigConfig) -> list[Trend]:
    """Of all axes and quantities that both measured. Raises RigError where there is none."""
    found = []
    for name, axis in second.axes.items():
        before, now = first.axes[name].measured if name in first.axes else None, axis.measured
        if before is None or now is None:
            continue
        for key in MeasuredConfig.model_fields:
            then, value = getattr(before, key), getattr(now, key)
            if isinstance(then, list) and isinstance(value, list) and key != "validation":
                found.append(Trend(name, key, then, value))
    if not found:
        raise RigError(["no axis has [axes.NAME.measured] in both files: hil identify RIG --write NEW.toml makes one"])
    return found


def show_trends(console: Console, found: list[Trend], first: RigConfig, second: RigConfig) -> None:
    """A table, and a line for each quantity that left both intervals."""
    dates = [{name: axis.measured.date for name, axis in rig.axes.items() if axis.measured} for rig in (first, second)]
    table = Table(title=f"{second.name}: measured, with half widths at 95 %")
    for column in ("axis", "quantity", "first", "second", "change"):
        table.add_column(column, justify="left" if column in ("axis", "quantity") else "right")
    for one in found:
        change = f"{100.0 * (one.second[0] / one.first[0] - 1.0):+.2f} %" if one.first[0] else ""
        cells = (f"{value:.5g} +- {width:.2g}" for value, width in (one.first, one.second))
        table.add_row(one.axis, one.quantity, *cells, f"[bold]{change}, beyond both" if one.left else change)
    console.print(table)
    for name in dict.fromkeys(one.axis for one in found):
        left = [one.quantity for one in found if one.axis == name and one.left]
        if left:
            text = (
                f"{name}: {', '.join(left)} changed from {dates[0][name]} to {dates[1][name]}: wear, a screw, a cable?"
            )
            console.print(text, markup=False, highlight=False, soft_wrap=True)


def as_document(found: list[Trend]) -> dict[str, Any]:
    """For JSON."""
    return {
        "same": not any(one.left for one in found),
        "measured": [one._asdict() | {"left": one.left} for one in found],
    }
