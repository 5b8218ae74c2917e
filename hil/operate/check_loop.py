"""What `hil check` says of the loop on the stage that is really there: corners, measured responses, files."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rich.table import Table

from hil.analysis.frequency_response import LoopResponse, loop_response, measured_finding
from hil.analysis.loop_corners import AT_REST, MEASURED, NOMINAL, OFF, CornerFinding
from hil.cli.output import write_json
from hil.rig.schema import RigConfig, RigError


def measured_findings(rig: RigConfig, measured: Sequence[str], frd: Path | None) -> list[CornerFinding]:
    """Axes with each measured response ("AXIS=FILE"). frd: where the loop's frequency response is written, which
    python-control's `frd` takes. Raises RigError.
    """
    found: list[CornerFinding] = []
    files = [_axis_and_file(rig, text) for text in measured]
    if frd or files:
        response = loop_response(rig)
        found += [measured_finding(rig, response, axis, path) for axis, path in files]
        if frd:
            write_json(frd_document(rig, response), str(frd))
    return found


def _axis_and_file(rig: RigConfig, text: str) -> tuple[str, Path]:
    axis, sign, path = text.partition("=")
    if not sign or axis not in rig.axes:
        raise RigError([f"--measured {text}: AXIS=FILE, where AXIS is one of {', '.join(rig.axes)}"])
    return axis, Path(path)


def frd_document(rig: RigConfig, response: LoopResponse) -> dict[str, Any]:
    """Keys: sample_time (s), omega (rad/s, (k,)), axes.NAME.{loop, plant}.{real, imag}, each (k,)."""
    return {
        "sample_time": rig.period_ns * 1e-9,
        "omega": (math.tau * response.frequency_hz).tolist(),
        "axes": {
            name: {
                key: {"real": values[:, at].real.tolist(), "imag": values[:, at].imag.tolist()}
                for key, values in (("loop", response.loop), ("plant", response.plant))
            }
            for at, name in enumerate(rig.axes)
        },
    }


def corner_notes(found: Sequence[CornerFinding]) -> list[str]:
    """A line for each that is stable but has less margin than is good."""
    return [text for finding in found if finding.stable and (text := finding.lacks())]


def asked_note(law: str, found: Sequence[CornerFinding]) -> str:
    """Which margins are asked of the loop, and why."""
    measured = list(dict.fromkeys(finding.axis for finding in found if finding.measured))
    less = f" ({', '.join(measured)}, measured: {MEASURED[0]:g} dB, as less can be)" if measured else ""
    held = f", {AT_REST[0]:g} dB where friction holds the axis" if any(one.at_rest for one in found) else ""
    return (
        f"asked of {law}: {NOMINAL[0]:g} dB and {NOMINAL[1]:g} deg as the model says, since that may be off{less}; "
        f"{OFF[0]:g} dB and {OFF[1]:g} deg in corners, which are off already{held}"
    )


def measured_notes(rig: RigConfig) -> list[str]:
    """A line for each axis whose corners come from what was measured."""
    return [
        f"axis '{name}': corners from [axes.{name}.measured]"
        + (f" of {axis.measured.date}" if axis.measured.date else "")
        + f": {axis.tolerances.text(rigid=not (axis.model.mode_frequency_hz or axis.model.other_modes))}"
        for name, axis in rig.axes.items()
        if axis.measured is not None
    ]


def corner_table(found: Sequence[CornerFinding]) -> Table:
    """Per axis and kind the corner with the least margin."""
    table = Table("axis", "where its margin is least", "gain margin", "phase margin", "at", title="Off the model")
    groups: dict[tuple[str, bool], list[CornerFinding]] = {}
    for finding in found:
        groups.setdefault((finding.axis, finding.at_rest), []).append(finding)
    for (axis, _), group in groups.items():
        worst = min(group, key=lambda finding: (finding.stable, min(finding.gain_db / 3.0, finding.phase_deg / 15.0)))
        table.add_row(
            axis,
            worst.corner,
            f"{worst.gain_db:.1f} dB" if worst.stable else "[red]unstable",
            f"{worst.phase_deg:.0f} deg" if worst.stable else "",
            f"{worst.frequency_hz:.0f} Hz",
        )
    return table
