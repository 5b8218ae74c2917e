"""A law of your own from a file (laws/lqr.py), held against the rig's own."""

from pathlib import Path

import hil

law = Path(__file__).parent / "laws" / "lqr.py"
rig = hil.load_rig("paper")
own = hil.simulate(rig.changed(f"law.name={law}:Lqr"), seconds=3.0)
shipped = hil.simulate(rig, seconds=3.0)
assert not own.law_failure, own.law_failure
for run in (shipped, own):
    print(run.rig.law.name, {axis: f"{row['rms_error'] * 1e9:.0f} nm" for axis, row in run.summary()["axes"].items()})
print(f"its slowest tick and the rest: hil check paper --law {law}:Lqr --margin 3")
