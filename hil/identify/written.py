"""What was identified as a new rig file: values in [axes.NAME.model], half widths and evidence in [axes.NAME.measured],
the values before in a comment.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import tomlkit
from tomlkit.items import InlineTable

from hil.identify.estimate import Estimate
from hil.rig.measured_table import MOST_OTHERS

MODEL_KEYS = (
    "mass", "coulomb", "viscous", "quadratic", "friction_period", "torque_lag", "mode_frequency_hz",
    "mode_damping", "mode_load",
)  # fmt: skip
OF_MODE = ("frequency_hz", "damping", "load")
OTHER_KEYS = [[f"other_mode_{number}_{key}" for key in OF_MODE] for number in range(1, MOST_OTHERS + 1)]
DIGITS = 6
NOT_CHECKED: Mapping[str, tuple[float, float]] = {}


def model_values(found: Mapping[str, Estimate]) -> dict[str, Any]:
    """Keys of [axes.NAME.model] with their values. The force that holds the axis is minus its gravity."""
    values: dict[str, Any] = {key: _rounded(found[key].value) for key in MODEL_KEYS if key in found}
    if others := [[_rounded(found[key].value) for key in keys] for keys in OTHER_KEYS if keys[0] in found]:
        values["other_modes"] = others
    if "constant" in found:
        values["gravity"] = _rounded(-found["constant"].value) + 0.0
    if "presliding" in found:
        one = found["presliding"]
        values["presliding"] = [_rounded(max(one.value - one.half_width, 1e-12)), _rounded(one.value + one.half_width)]
    return values


def rig_text(
    source: Path,
    axes: Mapping[str, Mapping[str, Estimate]],
    date: str,
    evidence: str,
    checked: Mapping[str, tuple[float, float]] = NOT_CHECKED,
) -> str:
    """The rig file with the identified values; all else, comments included, stays. date: of the measurement. checked:
    by axis, the force left unexplained in a motion that no fit used, and in one that was fitted, N RMS.
    """
    document = tomlkit.parse(source.read_text(encoding="utf-8"))
    tables: Any = document["axes"]
    for name, found in axes.items():
        values = model_values(found)
        if not values:
            continue
        model = tables[name]["model"]
        if "torque_lag" in found and "other_modes" in model:
            values.setdefault("other_modes", [])  # the frequency response shows none
        if "viscous" in found and "quadratic" in model:
            values.setdefault("quadratic", 0.0)  # a straight line explains friction
        before = {key: model.unwrap()[key] for key in values if key in model}
        for key, value in values.items():
            model[key] = value
        inline = isinstance(tables[name], InlineTable)  # on one line, which has room for no comment
        table: Any = tomlkit.inline_table() if inline else tomlkit.table()
        if not inline:
            table.add(tomlkit.comment(f"before: {before}"))
        for key, both in measured_values(found).items():
            table[key] = both
        if name in checked:
            table["validation"] = [_rounded(error) for error in checked[name]]
        table["date"], table["evidence"] = date, evidence
        tables[name]["measured"] = table
    return tomlkit.dumps(document)


def measured_values(found: Mapping[str, Estimate]) -> dict[str, list[float]]:
    """Keys of [axes.NAME.measured]: value and half width."""
    keys = (*MODEL_KEYS, *(key for keys in OTHER_KEYS for key in keys), "presliding")
    named = {key: found[key] for key in keys if key in found}
    if "constant" in found:
        one = found["constant"]
        named["gravity"] = one._replace(value=-one.value)
    return {key: [_rounded(one.value) + 0.0, _rounded(one.half_width)] for key, one in named.items()}


def _rounded(value: float) -> float:
    return float(f"{value:.{DIGITS}g}")
