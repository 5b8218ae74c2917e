"""What ordinary recordings tell of drawn stages: `python -m tests.benchmarks.recorded_stages --seed N --stages 20`.

Each drawn stage repeats a move under the microscope's own law and model; `hil identify --from` fits the run. Prints
errors and intervals as `hidden_stages` does.
"""

import argparse
from pathlib import Path

from hil.identify.findings import from_run
from hil.rig.file import load_rig
from hil.rig.shipped import by_name
from hil.runs.api import simulate
from hil.runs.rigs import Rig
from hil.studies.evidence.stages import nominal, only
from tests.benchmarks.hidden_stages import RIG, Errors, hidden

MOVES = {"x": ((3e-3, 0.15), (1e-2, 0.4)), "z": ((1e-3, 0.1), (3e-3, 0.2)), "theta": ((0.05, 0.15), (0.2, 0.4))}  # m, s
DWELL_S, RUN_S = 0.1, 6.0


def main() -> None:
    """Draw, run, compare."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--axis", default="x", choices=MOVES)
    parser.add_argument("--stages", type=int, default=20)
    parser.add_argument("--seed", type=int, required=True)
    parser.add_argument("--mode", type=float, default=150.0, help="Hz; 0: rigid")
    words = parser.parse_args()
    file = by_name("rigs", Path(RIG))
    known = only(nominal(load_rig(file), words.mode or None), [words.axis])
    for way, seconds in MOVES[words.axis]:
        print(f"moves of {way:g} in {seconds:g} s")
        errors = Errors()
        for number in range(words.stages):
            drawn, truth = hidden(words.axis, words.seed, number, words.mode, 0.0)
            rig = drawn.model_copy(update={"axes": known.axes})
            document = rig.model_dump(mode="json", exclude_none=True)
            document["task"] = {
                "kind": "point_to_point", "axes": [words.axis], "target": [way], "move_s": seconds, "dwell_s": DWELL_S
            }  # fmt: skip
            findings = from_run(simulate(Rig.build(document, file.parent), RUN_S), words.axis)
            errors.add(f"stage {number}", findings.found, findings.refused, truth)
        errors.show()


if __name__ == "__main__":
    main()
