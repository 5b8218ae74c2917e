"""What an estimator of users is: it tells the law, and nothing else, where an axis is and how fast it moves."""

from abc import ABC, abstractmethod
from typing import Any, NamedTuple

from hil.control.laws.base import Model


class Measurement(NamedTuple):
    """What an estimator of one axis may look at in one tick; floats, SI (rad, N m for rotary axes).

    position: the newest sample, m. fresh: 1.0 where a trusted sample came in this tick, else 0.0; then `position` is
    the rig filter's prediction for the instant the sample should have had, and nothing is to be learnt from it. age: s
    since the last trusted sample, 0.0 where this one is.
    interval: s from the previous sample's instant to this one's; 0.0 where a drive's time stamp stands still. ahead: s
    from this one's to that from which the next force acts.
    force, next_force: N, as applied; `force` acted in the interval, `next_force` acts while `ahead` passes. net_force,
    next_net_force: the same less what the nominal model says of friction and gravity, at the setpoint's velocity: over
    the mass, an acceleration.
    position_estimate, velocity_estimate: those of the rig's own filter where the next force begins to act, m, m/s.
    """

    position: float
    fresh: float
    age: float
    interval: float
    ahead: float
    force: float
    next_force: float
    net_force: float
    next_net_force: float
    position_estimate: float
    velocity_estimate: float


class Estimator(ABC):
    """An estimator of your own, of one axis; one object each, and each of many stages that run at once has its own.

        class AlphaBeta(hil.Estimator):
            def __init__(self, model, period, resolution, alpha=0.5, beta=0.1):
                self.alpha, self.beta = alpha, beta / period

            def reset(self, position):
                self.position, self.velocity = position, 0.0

            def update(self, measurement):
                m = measurement
                self.position += self.velocity * m.interval
                error = (m.position - self.position) * m.fresh
                self.position += self.alpha * error
                self.velocity += self.beta * error
                return self.position + self.velocity * m.ahead, self.velocity

    model: hil.Model of the axis, floats. period: s. resolution: m (rad) of a count. Parameters are those of
    [estimator.parameters].
    The law sees what `update` returns as position_estimate and velocity_estimate. Whatever protects the stage (limits,
    filter divergence, the damped stop) goes on with the rig's own filter.
    """

    def __init__(self, model: Model, period: float, resolution: float, **parameters: Any) -> None:  # noqa: B027
        """Every estimator is made like this."""

    @abstractmethod
    def reset(self, position: float) -> None:
        """At rest at `position` (m): the law is reset in the same tick."""

    @abstractmethod
    def update(self, measurement: Measurement) -> tuple[float, float]:
        """Position (m) and velocity (m/s) where the next force begins to act: `ahead` s after the measurement.

        Called in every tick in which the law is asked for a force, before it.
        """
