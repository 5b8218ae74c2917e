"""Activate a rig that is READY, let it move, stop it: python 11_command_a_live_rig.py [NAME]."""

import sys
import time

import hil

name = sys.argv[1] if len(sys.argv) > 1 else "microscope"
with hil.connect(name) as rig:
    rig.wait_for("READY")
    verdict = rig.command("activate")
    print("activate:", "accepted" if verdict.accepted else f"refused: {verdict.reason}")
    rig.wait_for("ACTIVE")
    time.sleep(0.5)
    print("stop:", rig.command("stop").accepted)
    print("it is", rig.wait_for("READY").state)
