"""Watch a rig that runs: python 10_watch_a_live_rig.py [NAME]. In a second terminal: hil demo microscope."""

import sys

import hil

name = sys.argv[1] if len(sys.argv) > 1 else "microscope"
with hil.connect(name) as rig:
    status = rig.status()
    print(name, status.state, dict(zip(status.axes, status.position, strict=True)))
    ticks = 0
    for columns in rig.telemetry():
        ticks += len(columns["index"])
        print(f"tick {columns['index'][-1]}: force {columns['force'][-1]}")
        if ticks >= 200:
            break
