"""Send a stage to places, jog it, stream to it. In virtual time; `hil.motion("microscope")` moves the rig that runs."""

import math

import hil

with hil.motion(hil.load_rig("microscope-ideal")) as stage:
    stage.move_to(x=1e-3, y=-5e-4).wait()
    stage.move_by(z=-2e-4, speed=0.2).wait()  # a fifth of the speed that goals may have
    stage.jog(x=2e-3, seconds=0.3)
    stage.wait()
    stage.path({"x": [0.0, 1e-3, 1e-3], "y": [0.0, 0.0, 1e-3]}, speed=0.02, blend=1e-5).wait()
    angles = [2.0 * math.pi * k / 200 for k in range(201)]  # a circle of 100 um, a point every 10 ms
    stage.stream((0.01 * k, {"x": 1e-4 * math.cos(a), "y": 1e-4 * math.sin(a)}) for k, a in enumerate(angles))
    look = stage.wait()
    try:
        stage.move_to(x=1.0)
    except hil.GoalRefusedError as refused:
        print("refused:", refused)

print("in position:", ", ".join(f"{name} {at * 1e3:.4f}" for name, at in zip(stage.axes, look.position, strict=True)))
