"""Model-predictive control: all axes at once, looking twelve periods ahead (laws/mpc.py)."""

from pathlib import Path

import hil

law = Path(__file__).parent / "laws" / "mpc.py"
rig = hil.load_rig("paper", [f"law.name={law}:PreviewMpc"])
for effort in (0.5, 1.0, 2.0):
    run = hil.simulate(rig.changed(f"law.gains.effort={effort}"), seconds=2.0)
    row = run.summary()["axes"]["x"]
    print(f"effort {effort:g} N: {row['max_error'] * 1e6:.2f} um at most, chatter {row['chatter'] * 1e3:.1f} mN")
