"""Run a shipped rig in virtual time, and draw what it did."""

import hil

run = hil.simulate("paper", seconds=4.0)
for axis, figures in run.summary()["axes"].items():
    print(f"{axis}: at most {figures['max_error'] * 1e6:.2f} um, {figures['rms_error'] * 1e9:.0f} nm RMS")
print(run.plot("tracking.png"), run.report("run.html"))
