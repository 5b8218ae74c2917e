"""Record a run, read it back, replay it, and write it as a table."""

import hil

hil.simulate("paper", 2.0, record="run.mcap")
run = hil.load_run("run.mcap")
print(f"{len(run.time)} ticks, ended {run.state[-1]}; first events {[event.text for event in run.events[:2]]}")
print(f"largest force on {run.axes[0]}: {abs(run.force[:, 0]).max():.3f} N")
print(f"replayed: {hil.replay('run.mcap').different} ticks differ")
print(run.export("run.csv"), run.export("run.npz"))
