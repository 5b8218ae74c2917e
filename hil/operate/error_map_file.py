"""[axes.NAME.error_map] from the readings of a reference instrument, written into a new rig file."""

import datetime
import hashlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np
import tomlkit
from pydantic import ValidationError

from drivers.base.named_file import write_text
from drivers.base.toml_file import own_words
from hil.control.error_map import ErrorMap
from hil.control.laws.base import Array
from hil.operate.approach_file import ENCODER, Deviations, read_reference
from hil.rig.error_map_table import ErrorMapConfig
from hil.rig.schema import RigConfig, RigError
from hil.rig.shipped import by_name

DIGITS: Final = 12
INVERTED: Final = 20  # steps to the place whose corrected position is known: each leaves a hundredth of the last


def corrections(reference: Deviations, encoder: Deviations, before: ErrorMapConfig | None) -> ErrorMapConfig:
    """From the mean over runs and both directions at each target, so that reversal is left in; zero where the encoder
    says 0, or at the end of the targets next to it. before: the correction that the encoder's positions had already.
    Raises ValidationError where no scale is so wrong.
    """
    seen = np.array(encoder.targets) + _mean(encoder)
    off = _mean(reference) - _mean(encoder)
    true = seen + off - float(np.interp(0.0, seen, off))
    plain = seen if before is None else _uncorrected(ErrorMap(before.position, before.correction), seen)
    rounded = [
        [float(f"{value:.{DIGITS}g}") for value in values] for values in (plain.tolist(), (true - plain).tolist())
    ]
    return ErrorMapConfig(position=rounded[0], correction=rounded[1])


def _mean(of: Deviations) -> Array:
    found: Array = np.concatenate([of.up, of.down], axis=1).mean(axis=1)
    return found


def _uncorrected(error_map: ErrorMap, corrected: Array) -> Array:
    """Where the encoder alone says that the axis is."""
    plain = corrected
    for _ in range(INVERTED):
        plain = plain + (corrected - error_map.corrected_array(plain))
    return plain


def write_corrected(rig: Path, config: RigConfig, reference: Path, target: Path) -> None:
    """A new rig file: that of `rig`, with the error map of every axis that the file of readings has, and without
    law.learnt, which was learnt at other positions. Raises RigError, and OSError where `target` cannot be written.
    """
    names = config.axis_names
    read, by_encoder = read_reference(reference, names), read_reference(reference, names, ENCODER)
    found = {}
    for name, axis in read.items():
        try:
            found[name] = corrections(axis, by_encoder[name], config.axes[name].error_map)
        except ValidationError as error:
            why = own_words(error.errors()[0]["msg"])
            raise RigError([f"{reference}, axis {name}: {why}"]) from None
    digest = hashlib.sha256(reference.read_bytes()).hexdigest()
    text = _rig_text(by_name("rigs", rig), found, f"{reference.name} sha256 {digest[:16]}")
    write_text(target, text)


def _rig_text(source: Path, found: Mapping[str, ErrorMapConfig], evidence: str) -> str:
    document = tomlkit.parse(source.read_text(encoding="utf-8"))
    axes: Any = document["axes"]
    law: Any = document.get("law", {})
    law.pop("learnt", None)
    for name, error_map in found.items():
        table = tomlkit.table()
        table["position"], table["correction"] = error_map.position, error_map.correction
        table["date"], table["evidence"] = datetime.date.today().isoformat(), evidence
        axes[name]["error_map"] = table
    return tomlkit.dumps(document)
