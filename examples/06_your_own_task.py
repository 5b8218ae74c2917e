"""A path of your own from a CSV file: time and positions; hil makes it smooth and refuses what no axis can do."""

from pathlib import Path

import numpy as np

import hil

time = np.linspace(0.0, 4.0, 201)
turn = (1.0 - np.cos(np.pi * time / 4.0)) / 2.0  # from 0 to 1, at rest at both ends
x, y = 0.02 * turn * np.cos(4.0 * np.pi * turn), 0.02 * turn * np.sin(4.0 * np.pi * turn)
file = Path("spiral.csv").resolve()
np.savetxt(file, np.stack([time, x, y], axis=1), delimiter=",", header="time_s,x,y", comments="")

task = ["task.kind=path", f"task.file={file}"]
run = hil.simulate(hil.load_rig("paper", task), seconds=5.0)
print(run.summary()["final_state"], f"{run.summary()['axes']['x']['max_error'] * 1e6:.2f} um at most")
file.write_text("time_s,x,y\n0,0,0\n1,9,0\n")
try:
    hil.load_rig("paper", task)
except hil.RigError as error:
    print(f"as it should be: {error}")

# Or a program that makes the path, run once when the rig is loaded: here a rose of five petals.
program = Path(__file__).parent / "tasks" / "rose.py"
rose = [f"task.kind={program}:Rose", "task.axes=['x', 'y']", "task.parameters.petals=5"]
print(f"{hil.simulate('paper', 6.0, overrides=rose).summary()['axes']['y']['max_error'] * 1e6:.2f} um at most")
