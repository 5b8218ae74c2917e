"""A stage that was identified, moved: `python -m tests.benchmarks.identified_moves --seed N --stages 20 [--mode 150]`.

Each drawn stage is identified by all experiments, from a model that is 30 % too small in everything. Then it does
10 mm at 1 Hz under the microscope's own law, with the model and the half widths that were found. Prints peak and RMS
of each stage between 5 and 9 s, and the margins that `hil check` finds; at the end medians and 95 %, and the least.
"""

import argparse
import math
from pathlib import Path

import numpy as np

from hil.analysis.loop_corners import check_corners
from hil.identify.estimate import Estimate
from hil.identify.lockstep import identify
from hil.identify.written import measured_values, model_values
from hil.rig.measured_table import MeasuredConfig
from hil.rig.schema import AxisConfig, RigConfig
from hil.rig.shipped import by_name
from hil.runs.api import simulate
from hil.runs.rigs import Rig
from tests.benchmarks.hidden_stages import RIG, hidden

REACH, TURN, ROWS = 10e-3, 2.0 * math.pi, 500
JUDGED_S = (5.0, 9.0)


def identified(axis: AxisConfig, found: dict[str, Estimate]) -> AxisConfig:
    """As `hil identify --write` writes it."""
    model = axis.model.model_copy(update=model_values(found))
    measured = MeasuredConfig.model_validate(measured_values(found))
    return axis.model_copy(update={"model": model, "measured": measured})


def moved(rig: RigConfig, axis: str) -> tuple[float, float]:
    """Peak and RMS error, m, of 10 mm at 1 Hz between JUDGED_S; inf where it was lost."""
    limits = rig.axes[axis].limits
    reach = min(REACH, 0.8 * limits.position[1], 0.8 * limits.speed / TURN)
    rows = [[second, -reach * math.cos(TURN * second)] for second in np.linspace(0.0, 1.0, ROWS + 1).tolist()]
    task = {"kind": "path", "axes": [axis], "samples": rows, "repeat": True, "approach_s": 1.0, "settle_s": 0.0}
    document = rig.model_dump(mode="json", exclude_none=True) | {"task": task}
    run = simulate(Rig.build(document, by_name("rigs", Path(RIG)).parent), JUDGED_S[1] + 3.0)
    seconds = run.columns["task_ns"] * 1e-9 - 1.0
    assert run.true is not None
    judged = (run.true - run.setpoint)[(seconds >= JUDGED_S[0]) & (seconds < JUDGED_S[1]), 0]  # of the tool
    if run.summary()["faults"] or not np.isfinite(judged).all():
        return np.inf, np.inf
    return float(np.abs(judged).max()), float(np.sqrt((judged**2).mean()))


def main() -> None:
    """Draw, identify, move, print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--axis", default="x")
    parser.add_argument("--mode", type=float, default=150.0, help="Hz of the free axis; 0: rigid")
    parser.add_argument("--stages", type=int, default=20)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--seed", type=int, required=True)
    parser.add_argument("--hard", action="store_true", help="stages as those of `hil evidence --hard`")
    words = parser.parse_args()
    errors, nominals, corners = [], [], []
    for number in range(words.first, words.first + words.stages):
        hidden_rig, _ = hidden(words.axis, words.seed, number, words.mode, 0.3, hard=words.hard)
        found = identify(hidden_rig, Path("."), [words.axis], lambda text: None)[words.axis].found
        axes = {words.axis: identified(hidden_rig.axes[words.axis], found)}
        rig = hidden_rig.model_copy(update={"axes": axes})
        margins = [(one.nominal, one.gain_db, one.phase_deg) for one in check_corners(rig) if not one.at_rest]
        nominals.append(next(one[1:] for one in margins if one[0]))
        corners.append(np.min([one[1:] for one in margins], axis=0).tolist())
        errors.append(moved(rig, words.axis))
        peak, rms = (1e9 * value for value in errors[-1])
        (gain, phase), (least, turn) = nominals[-1], corners[-1]
        print(
            f"stage {number}: peak {peak:.0f} nm, RMS {rms:.1f} nm; {gain:.1f} dB, {phase:.0f} deg as identified, "
            f"{least:.1f} dB, {turn:.0f} deg in corners",
            flush=True,
        )
    for name, values in zip(("peak", "RMS"), 1e9 * np.array(errors).T, strict=True):
        print(f"{name}: {np.median(values):.4g} / {np.quantile(values, 0.95, method='higher'):.4g} nm (median / 95 %)")
    for name, pairs in (("as identified", nominals), ("in corners", corners)):
        gain, phase = np.min(pairs, axis=0)
        print(f"least margins {name}: {gain:.1f} dB, {phase:.0f} deg")


if __name__ == "__main__":
    main()
