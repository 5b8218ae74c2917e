"""Frequency response from periods of a multisine, and the axis that fits it.

Force and position are averaged over periods apart before they are divided, which is unbiased in closed loop
(Pintelon, Schoukens, System Identification, 2nd ed., 2012, 2.7): G = sum Y / sum U. The response is that of the
sampled axis, from the force that is held over a period to the position at that period's beginning.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from hil.analysis.flexible_plant import AxisDynamics
from hil.identify.estimate import Array, Estimate, Refused, t95
from hil.identify.mode_seeds import Stiffness, seeds
from hil.identify.modes_told import Mode, modes_told

Complex = NDArray[np.complex128]
LEAST_PAIRS = 4
LEAST_COHERENCE = 0.9
WIDEST = 25.0  # of a logarithm
LEAST_LINES = 15
WORST_CHI2 = (20.0, 20.0, 8.0, 8.0)  # by number of modes: what several leave may be one more
FLOOR = 2e-3  # least deviation of a line assumed, relative
MOST_MODES = 3
# Of an axis' parameters q: log mass, lag and delay together (s), viscous (N s/m), delay; of each mode log Hz, log
# damping and the logit of its load. STEPS: of the search. SYSTEMATIC: what no pass shows, of times by the rounding of
# forces and stamps.
DELAY, RIGID, OF_MODE = 3, 4, 3
STEPS = np.array([0.1, 1e-4, 1.0, 1e-5, *MOST_MODES * (0.1, 0.5, 0.5)])
SYSTEMATIC = np.array([2e-4, 1.2e-6, 0.0, 1.2e-6, *MOST_MODES * (2e-4, 1e-3, 1e-3)])
LEAST_DELAY = 3e-6  # s, that is told apart from the lag
MODE_GAIN = 4.0  # by which modes must lower chi^2 to be told
NOISE = 1.0  # chi^2 below which nothing is left that another mode could explain
SEEDS = 2
LEAST_LOAD, MOST_LOAD = 1e-9, 0.95  # of the mass, that the search may try


class Pass(NamedTuple):
    """force (N) and position (m) of one pass at constant speed, (n,); late: by how many s after a position's instant
    its force began. direction: of the motion, sign: of the multisine, 1 or -1. start: tick of its first value, counted
    where the multisine's phase is 0. way: number of those that the same places are passed on.
    """

    force: Array
    late: Array
    position: Array
    direction: int
    sign: int
    start: int
    way: int = 0


class Response(NamedTuple):
    """frequency_hz (k,), response and deviation of its mean (k,) in m/N, coherence (k,); passes: the response by each
    pair of passes, (pairs, k).
    """

    frequency_hz: Array
    response: Complex
    deviation: Array
    coherence: Array
    passes: Complex


class Axis(NamedTuple):
    """An axis fitted to a response; response: of that axis at all the lines, (k,); `chi2` is per degree of freedom."""

    found: dict[str, Estimate]
    refused: dict[str, str]
    response: Complex
    chi2: float


def paired(passes: Sequence[Pass]) -> list[tuple[Pass, Pass]]:
    """Passes of one direction and opposite sign, the positive first: of one way, or what others leave."""
    pairs: list[tuple[Pass, Pass]] = []
    for direction in (1, -1):
        positive, negative = ([p for p in passes if (p.direction, p.sign) == (direction, sign)] for sign in (1, -1))
        same = {p.way for p in positive} & {p.way for p in negative}
        for chosen in (True, False):
            pairs += zip(
                *([p for p in each if (p.way in same) == chosen] for each in (positive, negative)), strict=False
            )
    return pairs


def too_few_pairs(passes: Sequence[Pass]) -> str:
    """In words, where they make fewer than LEAST_PAIRS; else ""."""
    pairs = len(paired(passes))
    return f"{pairs} pairs of passes with the multisine (at least {LEAST_PAIRS})" if pairs < LEAST_PAIRS else ""


def response_of(passes: Sequence[Pass], period: float, lines: Sequence[int], base: int) -> Response:
    """From passes at constant speed. lines: multiples of 1 / (base period) that were excited, at least 2 apart. The
    passes are all of `n` ticks, a multiple of `base` and at least twice that, for the window that keeps what does not
    repeat out of the lines.

    Two passes of one direction and opposite sign are taken together: what repeats along the travel drops out of their
    difference. Raises Refused.
    """
    if too_few := too_few_pairs(passes):
        raise Refused(too_few)
    pairs = paired(passes)
    n, m = len(passes[0].force), len(pairs)
    at = np.array(lines) * (n // base)
    window = np.hanning(n + 1)[:n]
    line = np.linspace(-1.0, 1.0, n)

    def windowed(values: Array) -> Array:
        level: Array = (values - np.polyval(np.polyfit(line, values, 1), line)) * window
        return level

    def spectra(p: Pass) -> Complex:
        turned = p.sign * np.exp(-2j * np.pi * at / n * p.start)
        force = _of_steps(windowed(p.force), p.late / period, 2.0 * np.pi * at / n)
        both: Complex = np.array([turned * force, turned * np.fft.rfft(windowed(p.position))[at]])
        return both

    force, position = np.array([0.5 * (spectra(a) + spectra(b)) for a, b in pairs]).swapaxes(0, 1)
    power = (np.abs(force) ** 2).sum(axis=0) * (np.abs(position) ** 2).sum(axis=0)
    coherence: Array = np.abs((position * force.conj()).sum(axis=0)) ** 2 / power
    mean = force.mean(axis=0)
    response: Complex = position.mean(axis=0) / mean
    rest = position - response * force  # noise of a pair, seen at the output
    deviation = np.sqrt((np.abs(rest) ** 2).sum(axis=0) / (m - 1) / m) / np.abs(mean)
    return Response(np.array(lines) / (base * period), response, deviation, coherence, response + rest / mean)


def _of_steps(values: Array, late: Array, angles: Array) -> Complex:
    """Spectrum at the angles (rad a period) of a force held from tick to tick, each step `late` periods after its tick.
    Without delays it is the discrete Fourier transform of the values.
    """
    when = np.arange(values.size + 1) + np.append(late, 0.0)
    steps = np.diff(values, prepend=0.0, append=0.0)
    spectrum: Complex = np.exp(-1j * np.outer(angles, when)) @ steps / (1.0 - np.exp(-1j * angles))
    return spectrum


def _by_mode(values: Array) -> list[Array]:
    """Of parameters q, those of each mode."""
    return list(values[RIGID:].reshape(-1, OF_MODE))


def _hung(q: Array) -> tuple[float, float, float]:
    """Hz, damping ratio and part of the mass."""
    load = MOST_LOAD / (1.0 + np.exp(-q[2]))
    return _exp(q[0]), _exp(q[1]), max(float(load), LEAST_LOAD)


def _exp(logarithm: float) -> float:
    """Within what a search may try and numbers bear: a mass of 0 has no motion."""
    return float(np.exp(np.clip(logarithm, -WIDEST, WIDEST)))


def _dynamics(q: Array) -> AxisDynamics:
    mass, lag, viscous = _exp(q[0]), float(abs(q[1] - q[DELAY])) + 1e-7, float(q[2])
    first, *others = [_hung(mode) for mode in _by_mode(q)] or [(0.0, 0.0, 0.0)]
    return AxisDynamics(mass, lag, *first, viscous)._replace(others=tuple(others))


def _parameters(axis: AxisDynamics) -> Array:
    modes = [
        (np.log(hertz), np.log(damping), np.log(load / (MOST_LOAD - load)))
        for hertz, damping, load in ((axis.mode_hz, axis.mode_damping, axis.mode_load), *axis.others)
    ]
    return np.array([np.log(axis.mass), axis.lag, axis.viscous, 0.0, *np.ravel(modes)])


class _Fit(NamedTuple):
    q: Array
    chi2: float
    jacobian: Array


class _Lines(NamedTuple):
    """Those that count: omega (rad/s), response, its deviation (relative), the response by each pair of passes."""

    omega: Array
    response: Complex
    sigma: Array
    passes: Complex
    period: float

    def rest(self, q: Array, data: Complex) -> Array:
        """What q leaves of a response, in log magnitude and phase, over the deviation."""
        with np.errstate(all="ignore"):  # the search may try what no axis is
            ratio = np.log(_dynamics(q).response(self.omega, self.period, float(q[DELAY])) / data)
        whole: Array = np.concatenate([ratio.real, ratio.imag]) / np.concatenate([self.sigma, self.sigma])
        return whole

    def fit(self, start: Array, *, delayed: bool = False) -> _Fit:
        """From there; the delay is searched, too, where `delayed`."""
        free = np.flatnonzero(delayed | (np.arange(start.size) != DELAY))
        scale = STEPS[: start.size][free]

        def placed(values: Array) -> Array:
            q = start.copy()
            q[free] = values * scale
            return q

        done = least_squares(
            lambda values: self.rest(placed(values), self.response), start[free] / scale, max_nfev=80, x_scale="jac"
        )
        jacobian = np.zeros((done.fun.size, start.size))
        jacobian[:, free] = done.jac / scale
        return _Fit(placed(done.x), 2.0 * float(done.cost) / (done.fun.size - free.size), jacobian)

    def best(self, mass_guess: float) -> _Fit:
        """With as many modes as tell themselves. Whether one more does is judged with the delay searched, too: no mode
        may stand for a delay, nor for what friction does below the lines. The search begins anew for each number of
        modes, and where that with one less ended.
        """
        best = last = self.fit(np.array([np.log(mass_guess), 2e-4, 0.0, 0.0]))
        left = self.fit(best.q, delayed=True).chi2
        for axes in seeds(self.omega, self.response, self.period, _exp(best.q[0]), MOST_MODES):
            if left < NOISE:
                break
            known = [_hung(mode) for mode in _by_mode(last.q)]
            mass, lag = _exp(last.q[0]), abs(float(last.q[1]))
            (_, more), *_ = Stiffness(self.omega, self.response, self.period, mass, lag, known).axes(1)
            begun = [*axes[:SEEDS], more]
            last = min((self.fit(_parameters(axis)) for axis in begun), key=lambda fit: fit.chi2)
            chi2 = self.fit(last.q, delayed=True).chi2
            slowest = min(hertz for hertz, _, _ in map(_hung, _by_mode(last.q)))
            if chi2 * MODE_GAIN < left and _loads(last.q) < MOST_LOAD and 2.0 * np.pi * slowest > self.omega[0]:
                best, left = last, chi2
        return best

    def half_widths(self, fit: _Fit) -> Array:
        """Of each parameter, at 95 %; infinite where the search ended nowhere."""
        if not np.isfinite(fit.jacobian).all():
            return np.full(fit.q.size, np.inf)
        steps = np.array([_step(fit.jacobian, -self.rest(fit.q, data)) for data in self.passes])
        m = len(steps)
        spread = steps.std(axis=0, ddof=1) / np.sqrt(m)
        covariance = np.linalg.norm(np.linalg.pinv(fit.jacobian), axis=1)
        random = t95(m - 1) * np.hypot(spread, covariance * np.sqrt(fit.chi2))
        half: Array = np.hypot(random, SYSTEMATIC[: random.size])
        return half


def fit_axis(measured: Response, period: float, mass_guess: float) -> Axis:
    """Mass, lag and delay of the force, and the mode, where there is one. The delay is told apart where it is surely
    there. Raises Refused where the response is too poor.
    """
    good = measured.coherence >= LEAST_COHERENCE
    if good.sum() < LEAST_LINES:
        raise Refused(
            f"coherence above {LEAST_COHERENCE} in {int(good.sum())} of {good.size} lines (at least {LEAST_LINES}): "
            "more force or more passes are needed"
        )
    frequency, g = measured.frequency_hz[good], measured.response[good]
    sigma = np.maximum(measured.deviation[good] / np.abs(g), FLOOR)
    lines = _Lines(2.0 * np.pi * frequency, g, sigma, measured.passes[:, good], period)
    best = lines.best(mass_guess)
    delayed = lines.fit(best.q, delayed=True)
    if abs(delayed.q[DELAY]) > max(LEAST_DELAY, lines.half_widths(delayed)[DELAY]):
        best = delayed
    most = WORST_CHI2[len(_by_mode(best.q))]
    if best.chi2 > most:
        raise Refused(
            f"chi^2 {best.chi2:.0f} per degree of freedom (at most {most:.0f}): no axis of {MOST_MODES} modes or fewer "
            "fits"
        )
    found, refused = _told(best.q, lines.half_widths(best), frequency)
    omega = 2.0 * np.pi * measured.frequency_hz
    return Axis(found, refused, _dynamics(best.q).response(omega, period, float(best.q[DELAY])), best.chi2)


def _step(jacobian: Array, rest: Array) -> Array:
    """One Gauss-Newton step from the fit of the mean to that of a pass."""
    step, *_ = np.linalg.lstsq(jacobian, rest, rcond=1e-9)
    return np.asarray(step, dtype=np.float64)


def _loads(q: Array) -> float:
    """Part of the mass on springs."""
    axis = _dynamics(q)
    return axis.mode_load + sum([load for *_, load in axis.others])


def _told(q: Array, half: Array, frequency: Array) -> tuple[dict[str, Estimate], dict[str, str]]:
    d = _dynamics(q)
    found = {
        "mass": Estimate(d.mass, d.mass * float(half[0]), "kg"),
        "torque_lag": Estimate(d.lag + float(q[DELAY]), float(half[1]), "s"),
        "viscous": Estimate(d.viscous, float(half[2]), "N s/m"),
    }
    if q[DELAY]:
        found["delay"] = Estimate(float(q[DELAY]), float(half[DELAY]), "s")
    modes = [_mode(*each) for each in zip(_by_mode(q), _by_mode(half), strict=True)]
    told, refused = modes_told(modes, float(frequency[0]), float(frequency[-1]))
    return found | told, refused


def _mode(q: Array, half: Array) -> Mode:
    hertz, damping, load = _hung(q)
    slope = load * (1.0 - load / MOST_LOAD)
    return Mode(
        Estimate(hertz, hertz * float(half[0]), "Hz"),
        Estimate(damping, damping * float(half[1]), "1"),
        Estimate(load, slope * float(half[2]), "1"),
    )
