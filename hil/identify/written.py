"""What was identified as a new rig file: values in [axes.NAME.model], half widths and evidence as comments."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import tomlkit

from hil.identify.estimate import Estimate

MODEL_KEYS = ("mass", "coulomb", "viscous", "torque_lag", "mode_frequency_hz", "mode_damping", "mode_load")
DIGITS = 6


def model_values(found: Mapping[str, Estimate]) -> dict[str, Any]:
    """Keys of [axes.NAME.model] with their values. The force that holds the axis is minus its gravity."""
    values: dict[str, Any] = {key: _rounded(found[key].value) for key in MODEL_KEYS if key in found}
    if "constant" in found:
        values["gravity"] = _rounded(-found["constant"].value) + 0.0
    if "presliding" in found:
        one = found["presliding"]
        values["presliding"] = [_rounded(max(one.value - one.half_width, 1e-12)), _rounded(one.value + one.half_width)]
    return values


def rig_text(source: Path, axes: Mapping[str, Mapping[str, Estimate]], note: str) -> str:
    """The rig file with the identified values; all else, comments included, stays. note: date and evidence."""
    document = tomlkit.parse(source.read_text(encoding="utf-8"))
    tables: Any = document["axes"]
    for name, found in axes.items():
        values = model_values(found)
        if not values:
            continue
        model = tables[name]["model"]
        before = {key: model.unwrap()[key] for key in values if key in model}
        for key, value in values.items():
            model[key] = value
        measured = ", ".join(f"{key} {one.value:.5g} +- {one.half_width:.2g} {one.unit}" for key, one in found.items())
        for text in (note, f"measured: {measured} (95 %)", f"before: {before}"):
            tables[name].add(tomlkit.comment(text))
    return tomlkit.dumps(document)


def _rounded(value: float) -> float:
    return float(f"{value:.{DIGITS}g}")
