"""What an identification found, as a table for people and as a document for programs."""

import re
from typing import Any

from rich.console import Console
from rich.table import Table

from hil.identify.estimate import Estimate
from hil.identify.findings import Findings
from hil.identify.written import OTHER_KEYS, measured_values, model_values
from hil.rig.measured_table import changed
from hil.rig.schema import RigConfig

ROTARY = {
    "kg": "kg m^2", "N": "N m", "m": "rad", "um": "urad", "N s/m": "N m s/rad", "N s^2/m^2": "N m s^2/rad^2",
    "N/m": "N m/rad", "N s": "N m s",
}  # fmt: skip
_AMOUNT = re.compile(rf"(?<=[0-9] )(?:{'|'.join(sorted(ROTARY, key=len, reverse=True))})(?![\w/])")


def show(console: Console, rig: RigConfig, findings: dict[str, Findings]) -> None:
    """Values, what a motion that no fit used left unexplained, refusals, and changes since the last identification."""
    table = Table(title=f"{rig.name}: identified, with 95 % intervals")
    for column in ("axis", "quantity", "value", "half width", "unit", "rig file"):
        table.add_column(
            column,
            justify="right" if column in ("value", "half width", "rig file") else "left",
            overflow="fold",  # names differ at their ends
        )
    for name, one in findings.items():
        for quantity, estimate in one.found.items():
            cells = (f"{estimate.value:.5g}", f"{estimate.half_width:.2g}", _unit(estimate, rig.axes[name].kind))
            table.add_row(name, quantity, *cells, _stated(rig, name, quantity))
    console.print(table)
    for name, one in findings.items():
        if one.validation:
            error, own = one.validation
            unit = "N" if rig.axes[name].kind == "linear" else "N m"
            text = f"{name}: {error:.2g} {unit} RMS unexplained in a motion that no fit used, {own:.2g} {unit} in moves"
            console.print(text, markup=False, highlight=False, soft_wrap=True)
        for quantity, why in one.refused.items():
            text = f"{name}: {quantity} refused: {_why(why, rig.axes[name].kind)}"
            console.print(text, markup=False, highlight=False, soft_wrap=True)
        for text in _changes(rig, name, one):
            console.print(f"{name}: changed: {text}", markup=False, highlight=False, soft_wrap=True)


def _changes(rig: RigConfig, axis: str, one: Findings) -> list[str]:
    """Since the measurement that the rig file tells of."""
    before = rig.axes[axis].measured
    return [] if before is None else changed(before, measured_values(one.found))


def _unit(estimate: Estimate, kind: str) -> str:
    return estimate.unit if kind == "linear" else ROTARY.get(estimate.unit, estimate.unit)


def _why(text: str, kind: str) -> str:
    """A refusal with the units of the axis: the fits write those of a linear one."""
    return text if kind == "linear" else _AMOUNT.sub(lambda found: ROTARY[found[0]], text)


def _stated(rig: RigConfig, axis: str, quantity: str) -> str:
    """What the rig file says of it."""
    model = rig.axes[axis].model
    if quantity == "constant":
        return f"{0.0 - model.gravity:.5g}"
    for keys, mode in zip(OTHER_KEYS, model.other_modes, strict=False):
        if quantity in keys:
            return f"{mode[keys.index(quantity)]:.5g}"
    value = getattr(model, quantity, None)
    if isinstance(value, list):
        return " to ".join(f"{each:.3g}" for each in value)
    return "" if value is None else f"{value:.5g}"


def as_document(rig: RigConfig, findings: dict[str, Findings], evidence: str) -> dict[str, Any]:
    """All of it, for JSON."""
    axes = {
        name: {
            "found": {
                quantity: estimate._replace(unit=_unit(estimate, rig.axes[name].kind))._asdict()
                for quantity, estimate in one.found.items()
            },
            "refused": {quantity: _why(why, rig.axes[name].kind) for quantity, why in one.refused.items()},
            "validation": one.validation,
            "model": model_values(one.found),
            "changes": _changes(rig, name, one),
        }
        for name, one in findings.items()
    }
    return {"rig": rig.name, "evidence": evidence, "axes": axes}
