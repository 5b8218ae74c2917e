"""Drives that a DBC file describes: a rig whose [bus.dbc] says which signal is which."""

import subprocess
import sys
from pathlib import Path

import hil

if not Path("bought.toml").exists():
    words = ["new", "bought.toml", "--layout", "dbc", "--axes", "x,y", "--force", "10", "--mass", "0.5"]
    subprocess.run([sys.executable, "-m", "hil", *words], check=True, stdin=subprocess.DEVNULL)
rig = hil.load_rig("bought.toml")
print(Path("bought.dbc").read_text().splitlines()[8])
print(rig.config.bus.protocol, hil.simulate(rig, seconds=2.0).summary()["final_state"])
