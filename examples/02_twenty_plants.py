"""One law on twenty stages that are not as the model says: mass and friction up to 30 % off."""

import numpy as np

import hil

draw = np.random.default_rng(1)
# One second to settle after the approach: errors are stated from 3 s on.
rig = hil.load_rig("paper", {"law.name": "structured-kalman", "task.settle_s": 1.0})
worst: list[float] = []
for mass, friction in draw.uniform(0.7, 1.3, (20, 2)):
    run = hil.simulate(rig.changed({"plant.mass_scale": mass, "plant.friction_scale": friction}), seconds=3.5)
    worst.append(run.summary()["axes"]["x"]["max_error"])
    print(f"mass x {mass:.2f}, friction x {friction:.2f}: {worst[-1] * 1e6:.2f} um")
print(f"median {np.median(worst) * 1e6:.2f} um, worst {max(worst) * 1e6:.2f} um")
