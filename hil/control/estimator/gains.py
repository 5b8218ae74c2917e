"""The rig's Kalman filter: position, velocity and disturbance force of every axis, from one sample per period.

Model per axis: mass * acceleration = input - disturbance, where the input is the applied force less the nominal
friction at the setpoint's velocity. The gains are filterpy's (hil/control/estimator/filterpy_design.py), constant; a
test holds the two filters equal.
"""

import contextlib
import json
import subprocess
import sys
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hil.control.estimator.gains_cache import load, store
from hil.rig.schema import RigConfig

Array = NDArray[np.float64]


def per_axis(value: Any, n: int) -> Array:
    """A scalar or list from the rig file as an array (n_axes,)."""
    return np.array(np.broadcast_to(np.asarray(value, dtype=np.float64), (n,)))


def filter_parameters(rig: RigConfig) -> list[dict[str, float]]:
    """Per axis, the arguments of filterpy_design.make_filter. A sample's noise is a count's quantisation, floored."""
    n = len(rig.axes)
    disturbance = per_axis(rig.estimator.disturbance_noise, n).tolist()
    acceleration = per_axis(rig.estimator.acceleration_noise, n).tolist()
    floor = rig.estimator.measurement_floor
    return [
        {
            "mass": axis.model.mass,
            "period": rig.period_ns * 1e-9,
            "disturbance_noise": disturbance[i],
            "acceleration_noise": acceleration[i],
            "sigma": max(axis.encoder_resolution / 12**0.5, floor),
        }
        for i, axis in enumerate(rig.axes.values())
    ]


_NO_GAINS = "[estimator] and axes.*.model.mass: no steady Kalman filter for these: "


@lru_cache(maxsize=64)
def _design_in_child(parameters: str) -> list[Any]:
    if "filterpy" in sys.modules:
        from hil.control.estimator.filterpy_design import design

        try:
            return design(json.loads(parameters))
        except (ArithmeticError, ValueError) as error:
            raise ValueError(_NO_GAINS + str(error)) from None
    cached = load(parameters)
    if cached is not None:
        return list(cached)
    child = subprocess.run(
        [sys.executable, "-m", "hil.control.estimator.filterpy_design"],
        input=parameters,
        capture_output=True,
        text=True,
        check=False,
        start_new_session=True,  # a Ctrl-C is for the command, which may go on; here it would read as a bad model
    )
    if child.returncode != 0:
        raise ValueError(_NO_GAINS + "".join(child.stderr.strip().splitlines()[-1:]))
    designed = list(json.loads(child.stdout))
    store(parameters, designed)
    return designed


def keep_design(rig: RigConfig) -> None:
    """Design the rig's filter in this process and cache it, unless it is cached: for many rigs one after another, as
    `design_gains` starts a process for each. A filter that has no steady gains is left to it.
    """
    parameters = json.dumps(filter_parameters(rig))
    if load(parameters) is None:
        from hil.control.estimator.filterpy_design import design

        with contextlib.suppress(ArithmeticError, ValueError):
            store(parameters, design(json.loads(parameters)))


def design_gains(rig: RigConfig) -> tuple[Array, Array]:
    """filterpy's steady-state gains, (3, n_axes), and innovation variances, (n_axes,), m^2.

    Raises ValueError where the rig's masses and noises have none.
    """
    result = _design_in_child(json.dumps(filter_parameters(rig)))
    gains = np.array([gain for gain, _ in result]).T.copy()
    variance = np.array([variance for _, variance in result])
    if not (np.isfinite(gains).all() and np.isfinite(variance).all() and (variance > 0.0).all()):
        raise ValueError(_NO_GAINS + f"gains {gains.tolist()}, innovation variances {variance.tolist()}")
    return gains, variance
