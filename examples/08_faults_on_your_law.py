"""What a law does when things break: a scripted bad day, then its acceptance with a slice of the fault campaign."""

from pathlib import Path

import hil

law = f"law.name={Path(__file__).parent / 'laws' / 'lqr.py'}:Lqr"
Path("bad.toml").write_text("""\
description = "a damaged answer now and then, then an encoder that dies"

[[fault]]
kind = "wire_drop"
node = "x"
at_phase = "approach"
duration_s = 0.5
probability = 0.01

[[fault]]
kind = "encoder_silent"
axis = "y"
at_phase = "figure"
after_s = 0.5
""")
run = hil.simulate("paper", 4.0, overrides=[law], scenario="bad.toml")
for event in run.events:
    print(f"{event.time:7.3f} s  {event.text}")
# The whole campaign: hil faults paper --set law.name=...
for finding in hil.accept_law("paper", [law]):
    print(f"{finding.step:16} {'passed' if finding.passed else 'failed'}  {finding.text}")
