"""A force sensor whose frames are its maker's, and a motion of your own that stops where it feels a cell."""

from pathlib import Path

import numpy as np

import hil

here = Path(__file__).parent
rig = [
    "task.kind=hold",
    f"motion.name={here}/motions/until_force.py:UntilForce",
    "motion.parameters.force=2e-4",
    f'sensors.force={{kind="{here}/sensors/scale.py:Scale", can_id=0x3F1, unit="N", scale=1.0, noise=5e-6, '
    "range=[-0.01, 0.01]}",
    "plant.sensors=[{sensor='force', measures='tip_force', axis='z'}]",
    "plant.cells=[]",
    "plant.dish={axes=['x', 'y', 'z'], positions=[[0.0, 0.0]], top=-1e-4}",
]
run = hil.simulate("microscope-ideal", 3.0, overrides=rig)
force, age = run.columns["readings"][:, 0], run.columns["reading_age"][:, 0]
print(f"felt {np.nanmax(force) * 1e3:.2f} mN at most; noise at rest {np.nanstd(force[:500]) * 1e6:.1f} uN")
print(f"no reading was older than {age[10:].max()} ticks")
