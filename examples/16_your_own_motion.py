"""A motion that decides as it goes: down to a cell until a force sensor feels it, then up again."""

from pathlib import Path

import numpy as np

import hil

program = Path(__file__).parent / "motions" / "until_force.py"
rig = [
    "task.kind=hold",
    f"motion.name={program}:UntilForce",
    "motion.parameters.force=2e-4",
    'sensors.force={can_id=0x3F1, unit="N", scale=1e-8, noise=5e-6, range=[-0.01, 0.01]}',
    "plant.sensors=[{sensor='force', measures='tip_force', axis='z'}]",
    "plant.cells=[]",
    "plant.dish={axes=['x', 'y', 'z'], positions=[[0.0, 0.0]], top=-1e-4}",
]
run = hil.simulate("microscope-ideal", 3.0, overrides=rig)
force, z = run.columns["readings"][:, 0], run.columns["position"][:, 2]
touched = int(np.argmax(force > 2e-4))
print(f"felt at {z[touched] * 1e6:.0f} um, at most {np.nanmax(force) * 1e3:.2f} mN; rests at {z[-1] * 1e6:.0f} um")
