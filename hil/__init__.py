"""The control service: one pure control cycle and the shells that run it live, in lockstep, or from a recording.

What Python programs use of it is listed in `__all__`, and loaded when it is first asked for: `import hil` itself loads
nothing. Everything else may change from one version to the next.
"""

import os

# Nothing in hil calls BLAS (bit determinism forbids it). One thread, set before numpy is imported, saves each process
# 40 MB and an idle thread beside the real-time loop.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

_PUBLIC = {
    "Command": "drivers.protocols.base",
    "DriveSide": "drivers.protocols.frame_layout",
    "DriveStatus": "drivers.protocols.base",
    "Estimator": "hil.control.estimator.contract",
    "Event": "hil.runs",
    "Frame": "drivers.frame",
    "FrameLayout": "drivers.protocols.frame_layout",
    "Gain": "hil.control.gain",
    "HostSide": "drivers.protocols.frame_layout",
    "Knob": "hil.control.gain",
    "Law": "hil.control.laws.base",
    "LawInputs": "hil.control.laws.base",
    "Measurement": "hil.control.estimator.contract",
    "Message": "drivers.protocols.base",
    "Model": "hil.control.laws.base",
    "Plant": "sim_plant.user_stage",
    "Recording": "hil.runs",
    "RecordingError": "hil.telemetry.recorder",
    "Reference": "hil.control.laws.base",
    "Reject": "drivers.protocols.base",
    "Rig": "hil.runs",
    "RigError": "hil.rig.schema",
    "Run": "hil.runs",
    "Sample": "drivers.protocols.base",
    "Simulation": "hil.runs",
    "Task": "hil.rig.task_kinds",
    "Wiring": "drivers.config",
    "LiveRig": "hil.connection",
    "NoGatewayError": "hil.connection",
    "NoSidecarError": "hil.connection",
    "connect": "hil.connection",
    "accept_law": "hil.studies.acceptance.law",
    "load_rig": "hil.runs",
    "load_run": "hil.runs",
    "replay": "hil.runs",
    "simulate": "hil.runs",
}
__all__ = sorted(_PUBLIC)


def __getattr__(name: str) -> object:
    if name not in _PUBLIC:
        raise AttributeError(f"module 'hil' has no attribute {name!r}")
    value = getattr(__import__("importlib").import_module(_PUBLIC[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return [*globals(), *__all__]
