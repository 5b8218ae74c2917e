"""A stage of your own, said in Python; `hil new my-stage.toml` asks for the same and writes a file."""

import hil

axis = {
    "encoder_resolution": 1e-7,  # m per count
    "rated_force": 10.0,  # N
    "limits": {"position": [-0.025, 0.025], "speed": 0.1, "force": 10.0, "force_rate": 2e4, "following_error": 5e-4},
    "model": {"mass": 0.5, "coulomb": 0.5},  # kg, N
}
task = {"kind": "circle", "axes": ["x", "y"], "radius": 0.005, "frequency_hz": 0.5, "approach_s": 0.5}
rig = hil.Rig.build({"name": "my-stage", "axes": {"x": axis, "y": axis}, "task": task})
run = hil.simulate(rig, seconds=3.0)
print(run.summary()["final_state"], {name: row["max_error"] for name, row in run.summary()["axes"].items()})
try:
    rig.changed("axes.x.limits.speeed=0.2")
except hil.RigError as error:
    print(f"as it should be: {error}")
