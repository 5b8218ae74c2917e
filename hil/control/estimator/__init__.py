"""Position and velocity from encoder samples: a Kalman filter with constant gains, the design of those gains, and the
estimators that users bring for the law.
"""

from collections.abc import Sequence

from hil.control.laws.base import Law, Model
from hil.rig.schema import RigConfig


def behind_estimator(law: Law, rig: RigConfig, model: Model, axes: Sequence[int]) -> Law:
    """A law on arrays (..., axes) behind the rig's estimator: the law itself where that is ours.

    model: of those axes, arrays. axes: their places in the rig. Raises ValueError naming the key.
    """
    if not rig.estimator.is_users:
        return law
    from hil.control.estimator.users import EstimatedLaw  # few rigs have one

    return EstimatedLaw(law, rig, model, axes)
