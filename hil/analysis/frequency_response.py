"""The loop gain over frequency, and what becomes of it with a measured axis in place of the model's.

L from the pulse response of the sensitivity (stability.py); the law with its filter is then L over the model's own
response, and a measured response takes the model's place. Stability by Nyquist's criterion: the measured loop turns
round -1 as often as the model's, which is stable.
"""

import csv
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from drivers.base.text_file import UnsuitableFileError, read_bounded, words_of
from drivers.base.toml_file import short
from hil.analysis.flexible_plant import FlexiblePlant
from hil.analysis.loop_corners import Corner, CornerFinding
from hil.analysis.pulse_loop import PulseLoop, responses
from hil.analysis.stability import margins_of_loop
from hil.control.laws.base import Array
from hil.control.nominal_model import rig_model
from hil.rig.schema import RigConfig, RigError

Complex = NDArray[np.complex128]
TICKS = 4000
COLUMNS = ("frequency_hz", "magnitude", "phase_deg")
LARGEST_FILE = 1 << 23  # bytes
MOST_LINES = 100_000


class LoopResponse(NamedTuple):
    """frequency_hz: (k,), rising, up to half the rate. loop: the loop gain, plant: position over force as sampled (m/N
    or rad/(N m)); (k, n_axes).
    """

    frequency_hz: Array
    loop: Complex
    plant: Complex


def loop_response(rig: RigConfig) -> LoopResponse:
    """Of every axis as its nominal model says, lag and mode included."""
    model, period = rig_model(rig), rig.period_ns * 1e-9
    loop = PulseLoop(rig, model)
    nominal = [Corner().dynamics(axis.model) for axis in rig.axes.values()]
    axes = [dynamics for dynamics in nominal if dynamics is not None]
    answer, _ = responses(loop, FlexiblePlant([axes] * loop.shape[0], period), TICKS)
    frequency = np.arange(1, TICKS // 2) / (TICKS * period)  # the last one is half the rate: no phase there
    gain: Complex = 1.0 / np.fft.rfft(answer[:, 0], axis=0)[1 : TICKS // 2] - 1.0
    plant: Complex = np.stack([dynamics.response(2.0 * np.pi * frequency, period) for dynamics in axes], axis=-1)
    return LoopResponse(frequency, gain, plant)


def read_response(path: Path) -> tuple[Array, Complex]:
    """(frequency_hz (k,), position over force (k,)) of a CSV file with the columns frequency_hz, magnitude (m/N) and
    phase_deg, its frequencies rising. Both are of the sampled axis: from the force that is held over each period to the
    position at that period's beginning; the period that the loop takes to answer is no part of it. Raises RigError
    naming line and value.
    """
    try:
        text = read_bounded(path, LARGEST_FILE).decode()
        lines = text.splitlines()
        if len(lines) > MOST_LINES:
            raise RigError([f"{path}: {len(lines)} lines: at most {MOST_LINES}"])
        rows = list(csv.reader(lines))
    except OSError as error:
        raise RigError([f"{path}: {words_of(error)}"]) from None
    except (UnicodeDecodeError, UnsuitableFileError, csv.Error) as error:
        raise RigError([f"{path}: {error}"]) from None
    if not rows or tuple(cell.strip() for cell in rows[0]) != COLUMNS:
        raise RigError([f"{path}: the first line has to be {','.join(COLUMNS)}"])
    values: list[tuple[float, float, float]] = []
    for number, row in enumerate(rows[1:], 2):
        try:
            frequency, magnitude, phase = map(float, row)
        except ValueError:
            raise RigError([f"{path}, line {number}: {short(','.join(row))!r} is not three numbers"]) from None
        if not (0.0 < frequency < np.inf and 0.0 < magnitude < np.inf and abs(phase) < np.inf):
            raise RigError([f"{path}, line {number}: frequency and magnitude have to be positive, all three finite"])
        if values and frequency <= values[-1][0]:
            raise RigError([f"{path}, line {number}: frequency {frequency:g} is not above {values[-1][0]:g}"])
        values.append((frequency, magnitude, phase))
    if len(values) < 3:
        raise RigError([f"{path}: {len(values)} frequencies; at least 3 are needed"])
    frequencies, magnitudes, phases = np.array(values).T
    response: Complex = magnitudes * np.exp(1j * np.radians(phases))
    return frequencies, response


def measured_finding(rig: RigConfig, response: LoopResponse, axis: str, path: Path) -> CornerFinding:
    """The loop of an axis with the measured response of read_response, over the frequencies that both have."""
    at = list(rig.axes).index(axis)
    frequency, measured = read_response(path)
    inside = (response.frequency_hz >= frequency[0]) & (response.frequency_hz <= frequency[-1])
    if inside.sum() < 3:
        raise RigError([f"{path}: {frequency[0]:g} to {frequency[-1]:g} Hz; allowed: below {rig.rate_hz / 2:g} Hz"])
    here, modelled = response.frequency_hz[inside], response.loop[inside, at]
    magnitude = np.exp(np.interp(here, frequency, np.log(np.abs(measured))))
    phase = np.interp(here, frequency, np.unwrap(np.angle(measured)))
    loop = modelled / response.plant[inside, at] * magnitude * np.exp(1j * phase)
    met = margins_of_loop(loop, here)
    turned = np.unwrap(np.angle((1.0 + loop) / (1.0 + modelled)))
    beyond = np.abs(turned - turned[0]) > np.pi  # from where on the one has gone round -1 more often than the other
    stable = not beyond[-1]
    where = met.tightest_at if stable else float(here[beyond.argmax()])
    found, known = (stable, met.gain_db, met.phase_margin, where), rig.axes[axis].tolerances.known > 0.0
    return CornerFinding(axis, f"measured ({path.name})", False, True, *found, known)
