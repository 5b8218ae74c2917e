"""Tune a law on a rig file of your own, and see what became of it."""

import subprocess
import sys
from pathlib import Path

import hil

file = Path("tuned.toml")
words = ["new", str(file), "--axes", "x", "--mass", "0.5", "--force", "10"]
if not file.exists():
    subprocess.run([sys.executable, "-m", "hil", *words], check=True, stdin=subprocess.DEVNULL)
before = hil.simulate(file, 3.0)
small = ["--population", "10", "--generations", "3"]  # the usual search takes minutes
subprocess.run([sys.executable, "-m", "hil", "tune", str(file), *small], check=True)
after = hil.simulate(file, 3.0)
for run in (before, after):
    row = run.summary()["axes"]["x"]
    print(run.rig.law.effective_gains(), f"{row['rms_error'] * 1e9:.0f} nm RMS")
print("largest differences by tick:", before.compare(after)["x"])
