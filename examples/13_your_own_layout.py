"""Drives with frames of their own: a layout of yours, a slip in it, and drives that lose a frame."""

from pathlib import Path

import hil

layout = Path(__file__).parent / "layouts" / "maker.py"
rig = hil.load_rig("paper", [f"bus.protocol={layout}:Maker", "bus.parameters.torque_unit=1e-3"])
run = hil.simulate(rig, seconds=2.0)
print(run.summary()["final_state"], f"{run.summary()['axes']['x']['max_error'] * 1e6:.2f} um at most")

# A slip: the host reads positions with the low byte first. Both sides are tried before anything runs.
slip = Path("slip.py").resolve()
slip.write_text(layout.read_text().replace('">iBB"', '"<iBB"'))
try:
    hil.simulate(rig.changed(f"bus.protocol={slip}:Maker"), seconds=0.1)
except hil.RigError as error:
    print(f"as it should be: {error}")

# The same rig on a wire that loses a frame in a thousand.
run = hil.simulate(rig.changed("wire.drop_probability=1e-3"), seconds=2.0)
print(run.summary()["final_state"], f"with {run.figures.samples_lost} samples lost")
