"""Trials of `hil tune` on what stages do beyond ideal friction, and plants that no search has seen.

Friction by the motion since the reversal over two decades of presliding, a drive's lag, the rig's mode, a constant
force and its step, cogging, a Stribeck peak, moves of micrometres; the models are sim_plant/physics/dynamics.py's. What
is good there is counted in what a force that no model knows costs any loop: about 15 T^2 F / m (15 um per m/s^2 at
1 kHz).
"""

from typing import Any

import numpy as np

from hil.rig.schema import RigConfig
from hil.studies.population import between as log_between
from hil.studies.tune.candidate_simulation import Trial

UNKNOWN = 15.0  # times T^2 F / m: see above
LEAST_COUNTS = 4.0
LEAST_PRESLIDING = 0.3e-6  # m (rad), where the rig's model states no range, and two decades from there
LAG_S = 1e-4  # where neither [plant] nor the model has one
BIAS = 0.1  # of Coulomb friction, as the step
COGGING = 0.03  # of Coulomb friction
STRIBECK = 0.3
PEAK_WIDTH = 0.25  # of the moves' greatest speed
MOVE_S, DWELL_S, GREATEST_MOVE = 0.15, 0.1, 0.5e-3
SMALL = 20e-6  # m (rad): a move within presliding friction


def _about(share: float) -> tuple[float, float]:
    return 1.0 - share, 1.0 + share


class StageTrials:
    """Of one axis of a rig. off: by how much its model may be off, as measured, else as is usual."""

    def __init__(self, rig: RigConfig, axis: int) -> None:
        self._rig = rig
        self._axis = axis
        self._name = rig.axis_names[axis]
        config = rig.axes[self._name]
        self._model = config.model
        self.off = config.tolerances  # of plants that are drawn
        self._period = rig.period_ns * 1e-9
        self._resolution = config.encoder_resolution
        low, high = config.limits.position
        fastest = 0.5 * config.limits.speed * MOVE_S / 1.875  # a minimum-jerk move's peak is 1.875 of its mean
        self._move = min(GREATEST_MOVE, 0.05 * (high - low), fastest)
        # An axis stuck on its friction that rings beyond half the rate is not to be held by any loop of that rate.
        ringing = self._model.coulomb / (self._model.mass * (np.pi * rig.rate_hz) ** 2)
        least = max(LEAST_PRESLIDING, ringing)
        least, greatest = self._model.presliding or (least, 100.0 * least)
        self._presliding = least, (least * greatest) ** 0.5, greatest
        self._lag = self._of_plant("torque_lag") or self._model.torque_lag or LAG_S
        self._mode = self._mode_of_rig()

    @property
    def is_real(self) -> bool:
        """Whether the rig says that its stage is more than ideal friction: in [axes.NAME.model], or [plant]."""
        stated = self._model.presliding or self._model.torque_lag or self._of_plant("torque_lag")
        return bool(stated or self._of_plant("presliding") or self._mode)

    def _of_plant(self, key: str) -> float:
        value = getattr(self._rig.plant, key)
        return float(value[self._axis] if isinstance(value, list) else value)

    def _mode_of_rig(self) -> dict[str, Any]:
        model = self._model
        if model.mode_frequency_hz:
            return {"frequency_hz": model.mode_frequency_hz, "damping": model.mode_damping, "load": model.mode_load}
        own, every = ([mode for mode in self._rig.plant.modes if mode.axis == axis] for axis in (self._name, None))
        tools = [mode.model_dump(exclude={"axis"}) for mode in own or every if mode.tool]
        return tools[0] if tools else {}

    def good(self, part: float) -> float:
        """Encoder counts: what `part` of Coulomb friction costs where no model knows it."""
        cost = UNKNOWN * self._period**2 * part * self._model.coulomb / self._model.mass
        return max(cost / self._resolution, LEAST_COUNTS)

    def moves(self, size: float) -> dict[str, Any]:
        """The task: to and fro by `size`."""
        return {
            "kind": "point_to_point", "axes": [self._name], "target": [self._start() + size],
            "move_s": MOVE_S, "dwell_s": DWELL_S, "settle_s": 2.0 * (MOVE_S + DWELL_S),
        }  # fmt: skip

    def _start(self) -> float:
        return self._of_plant("initial_position")

    def _cogging(self, period: float, phase: float) -> dict[str, Any]:
        line = {"amplitude": COGGING * self._model.coulomb, "period": period, "phase": phase}
        return {"cogging": [line]} if self._model.coulomb else {}

    def _ringing(self, scale: float) -> dict[str, Any]:
        return {"modes": [self._mode | {"frequency_hz": scale * self._mode["frequency_hz"]}]}

    def ideal(self) -> list[Trial]:
        """On friction that flips at v = 0: forces that no model knows, and moves of micrometres. Quick."""
        whole, small, good = self.moves(self._move), self.moves(SMALL), self.good
        friction, force = good(0.3), BIAS * self._model.coulomb
        peak = {"stribeck_scale": STRIBECK, "stribeck_velocity": PEAK_WIDTH * 1.875 * self._move / MOVE_S}
        ripple = {"ripple_amplitude": COGGING * self._model.coulomb, "ripple_period": self._move}
        found = [
            Trial("small moves", small, good(0.1)),
            Trial("constant force", whole, good(BIAS), plant={"bias": force}),
            Trial("step of force", whole, good(BIAS), step=force),
            Trial("cogging", whole, good(COGGING), plant=ripple),
            Trial("Stribeck", whole, friction, plant=peak),
        ]
        return [trial._replace(brief=True) for trial in found]

    def real(self) -> list[Trial]:
        """On friction by the motion since the reversal, behind a lag. A mode only where the rig states one, in
        [axes.NAME.model] or [plant].
        """
        whole, small, good = self.moves(self._move), self.moves(SMALL), self.good
        friction, force = good(0.3), BIAS * self._model.coulomb
        fine, middle, coarse = ({"presliding": x, "torque_lag": self._lag} for x in self._presliding)
        found = [
            Trial("presliding, fine", whole, friction, plant=fine),
            Trial("presliding", whole, friction, plant=middle),
            Trial("presliding, coarse", whole, friction, plant=coarse),
            Trial("presliding, twice the lag", whole, friction, plant=middle | {"torque_lag": 2.0 * self._lag}),
            Trial("presliding, small moves", small, good(0.1), plant=middle),
            Trial("presliding, step of force", whole, good(BIAS), plant=middle, step=force),
            Trial("presliding, cogging", whole, friction, plant=middle | self._cogging(self._move, 0.7)),
        ]
        if self._mode:
            found += [
                Trial(f"mode x {scale:g}", whole, friction, plant=middle | self._ringing(scale))
                for scale in _about(self.off.mode)
            ]
        return [trial._replace(brief=True) for trial in found]

    def unseen(self, count: int, seed: int, *, real: bool) -> list[Trial]:
        """As many plants with all of it at once, drawn from `seed`: mass and friction, constant force, cogging and its
        phase, the size of the moves. Where they are `real`, presliding (by its logarithm), lag and mode as well.
        """
        random = np.random.default_rng([seed, self._axis])
        least, _, greatest = self._presliding

        def between(low: float, high: float) -> float:
            return float(random.uniform(low, high))

        found = []
        for index in range(count):
            plant: dict[str, Any] = {"bias": self._model.coulomb * between(-BIAS, BIAS)}
            period, phase = self._move * between(0.5, 4.0), between(0.0, 6.283)
            if real:
                plant["presliding"] = log_between((least, greatest), between(0.0, 1.0))
                plant["torque_lag"] = self._lag * between(*_about(self.off.lag))
                plant |= self._cogging(period, phase)
                if self._mode:
                    plant |= self._ringing(between(*_about(self.off.mode)))
            else:  # the one line that the ideal axis has, and no phase
                plant |= {"ripple_amplitude": COGGING * self._model.coulomb, "ripple_period": period}
            size = self._move * between(0.05, 1.0)
            scales = between(*_about(self.off.mass)), between(*_about(self.off.friction))
            found.append(Trial(f"unseen {index}", self.moves(size), self.good(0.3), *scales, plant=plant, brief=True))
        return found
