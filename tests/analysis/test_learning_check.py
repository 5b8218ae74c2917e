"""What a repeat leaves of a disturbance: as `hil check` says it, and as the memory itself does it."""

import numpy as np
import pytest

from hil.analysis import learning_check
from hil.analysis.learning_check import check_learning, left_per_repeat
from hil.control.laws.repeat_memory import LAG, WARM_REPEATS, RepeatMemory
from hil.rig.file import load_rig
from hil.rig.schema import RigConfig
from hil.studies.evidence.stages import nominal
from tests.support.paths import RIGS

MODES = (0.0, 150.0, 200.0, 300.0)


def rig(law: str = "presliding-kalman", mode_hz: float = 0.0) -> RigConfig:
    changes = [f"law.name={law}", "law.iterative_learning=true"]
    return nominal(load_rig(RIGS / "microscope-ideal.toml", changes), mode_hz)


@pytest.mark.parametrize("mode_hz", MODES)
def test_learning_converges_on_every_axis_rigid_and_with_a_mode(mode_hz: float) -> None:
    found = check_learning(rig(mode_hz=mode_hz))
    assert [finding.axis for finding in found] == ["x", "y", "z", "theta"]
    for finding in found:
        assert finding.left == pytest.approx(0.3, abs=1e-3)
        assert finding.most < 0.98
        assert finding.problem() == ""


def test_a_lag_that_is_too_long_is_refused_with_the_frequency(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(learning_check, "LAG", LAG + 3)
    (x, *_) = check_learning(rig())
    assert 1.1 < x.most < 1.4
    assert 80.0 < x.frequency_hz < 110.0
    assert "grows by 1." in x.problem()


def test_other_laws_have_no_such_finding() -> None:
    assert check_learning(rig("structured-kalman")) == []
    assert check_learning(rig().model_copy(update={"law": load_rig(RIGS / "microscope-ideal.toml").law})) == []


@pytest.mark.parametrize("cycles", [2, 8])
def test_the_memory_leaves_what_the_formula_says(cycles: int) -> None:
    """What changes from repeat to repeat of a sinusoid, seen by an observer that knows it at the end of the period."""
    count, repeats = 200, WARM_REPEATS + 2
    memory, missing = RepeatMemory(count * 1_000_000, 0, 1e-3, 5.0), [0.0] * 2
    wave = np.sin(2.0 * np.pi * cycles * np.arange(count) / count)
    for tick in range(repeats * count):
        memory.note(tick, missing[-2], 0.0, 1.0)
        missing.append(wave[tick % count] - memory.force(tick))
    change = np.diff(np.array(missing[2:]).reshape(repeats, count), axis=0)
    first, second = np.abs(np.fft.fft(change[WARM_REPEATS - 1 :], axis=1)[:, cycles])
    pulse = np.zeros((2 * count, 1))
    pulse[0] = 1.0
    left, omega = left_per_repeat(pulse)
    assert omega[2 * cycles] == pytest.approx(2.0 * np.pi * cycles / count)
    assert second / first == pytest.approx(left[2 * cycles, 0], rel=0.03)
