"""Picture and frequency-response files of an identification, from data that other tests of this package write down."""

from pathlib import Path

import numpy as np
import pytest
from matplotlib.image import imread

from hil.analysis.frequency_response import read_response
from hil.identify.findings import Findings
from hil.identify.frequency_fit import fit_axis, response_of
from hil.identify.prediction import Unexplained
from hil.identify.report import identification_picture, write_responses
from hil.identify.travel_fit import travel_fit
from tests.identify.test_frequency_fit import BASE, LINES, PERIOD, passes
from tests.identify.test_travel_fit import COULOMB, SPEEDS, VISCOUS, one


@pytest.fixture(scope="module")
def findings() -> Findings:
    response = response_of(passes(True, 2e-9), PERIOD, LINES, BASE)
    travel = travel_fit([one(speed, waves=True) for speed in SPEEDS], PERIOD, 0.9).curves
    turns = np.linspace(0.0, 20.0, 500)
    return Findings(
        response=response,
        fitted=fit_axis(response, PERIOD, 0.5).response,
        travel=travel,
        loops=(1e-6 * np.sin(turns), np.cos(turns)),
        checked=Unexplained(turns, np.cos(turns), 0.01 * np.sin(5.0 * turns)),
        refused={"presliding": "at the bound of the search"},
    )


def test_a_frequency_response_is_written_as_check_reads_it(findings: Findings, tmp_path: Path) -> None:
    written = write_responses(tmp_path / "frf", {"x": findings, "y": Findings()})
    assert written == {"x": tmp_path / "frf" / "x.csv"}, "y has none"
    assert findings.response is not None
    hertz, response = read_response(written["x"])
    assert hertz == pytest.approx(findings.response.frequency_hz)
    assert response == pytest.approx(findings.response.response, rel=1e-6)


def test_the_curves_of_the_travel_are_friction_and_place(findings: Findings) -> None:
    curves = findings.travel
    assert curves is not None
    friction = COULOMB * (1.0 + 0.1 * np.sin(2.0 * np.pi * curves.position / 0.009 + 1.0))
    assert curves.friction == pytest.approx(friction, abs=0.01)
    assert curves.friction_at_speed == pytest.approx(COULOMB + VISCOUS * np.abs(curves.speed), abs=0.02)


@pytest.mark.long
def test_each_axis_has_a_row_of_panels(findings: Findings, tmp_path: Path) -> None:
    kinds = {"x": "linear", "theta": "rotary"}
    one_row, two_rows = tmp_path / "one.png", tmp_path / "pictures" / "two.png"
    identification_picture(one_row, {"x": findings}, kinds)
    identification_picture(two_rows, {"x": findings, "theta": Findings()}, kinds)
    assert imread(two_rows).shape[0] == 2 * imread(one_row).shape[0]
    assert np.std(imread(one_row)) > 0.05, "something is drawn"
