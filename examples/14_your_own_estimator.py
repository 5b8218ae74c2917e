"""An estimator of your own: what the law knows of position and velocity, a bandwidth, and one that fails."""

from pathlib import Path

import hil

observer = Path(__file__).parent / "estimators" / "luenberger.py"
shipped = hil.load_rig("paper")  # its law, pd-feedforward, acts on the estimate alone
own = shipped.changed(f"estimator.name={observer}:Luenberger")
for text, rig in (
    ("the rig's Kalman filter", shipped),
    *((f"{hz} Hz", own.changed(f"estimator.parameters.bandwidth_hz={hz}")) for hz in (15, 60, 150)),
):
    axes = hil.simulate(rig, seconds=2.0).summary()["axes"]
    print(f"{text:24}", {axis: f"{row['rms_error'] * 1e9:.0f} nm" for axis, row in axes.items()})

# A slip: the velocity is forgotten. The law is not asked behind it, the torque is zero, and the event has the line.
slip = Path("slip.py").resolve()
slip.write_text(observer.read_text().replace("return self.moved(m.next_net_force, m.ahead)", "return self.position"))
run = hil.simulate(shipped.changed(f"estimator.name={slip}:Luenberger"), seconds=0.5)
print(f"as it should be: {run.summary()['final_state']}, {run.law_failure}")
print(
    f"what it costs, and what breaks it: hil check paper --estimator {observer}:Luenberger --margin 3 --phase-margin 15"
)
