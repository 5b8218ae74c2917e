"""Whole runs: what `hil sim` says of them, and trace_sha256, which covers every frame with its virtual time.

Both ideal rigs with every law, some laws inside iterative learning, and the microscope as it is shipped.
"""

from hil.rig.file import load_rig
from hil.rig.law_names import LAWS
from hil.virtual.sim import simulate
from tests.golden.golden import outline
from tests.support.paths import RIGS

SLOW = True  # a minute: a few of them are held in every test run, all of them in the slow lane
SECONDS = 4.0
# Laws also run inside iterative learning, on a figure that repeats
LEARNING = ("pd-feedforward", "structured-kalman", "presliding-kalman")
REPEATS = ["task.frequency_hz=10.0", "task.radius=1e-3", "task.approach_s=0.1", "plant.coulomb=[2.0, 0.3]"]
IDEAL_RIGS = ("microscope-ideal", "paper")


def runs() -> dict[str, tuple[str, list[str]]]:
    """Rig and overrides of every run, by name."""
    plain = {f"{rig}, {law}": (rig, [f"law.name={law}"]) for rig in IDEAL_RIGS for law in LAWS}
    learning = {
        f"paper, {law}, learning": ("paper", [f"law.name={law}", "law.iterative_learning=true", *REPEATS])
        for law in LEARNING
    }
    return {**plain, **learning, "microscope": ("microscope", [])}


def stories() -> list[str]:
    """Their names."""
    return list(runs())


def tell(story: str) -> list[str]:
    """Of a run: errors of its axes, events, how it ended, and its trace_sha256."""
    name, overrides = runs()[story]
    report, _ = simulate(load_rig(RIGS / f"{name}.toml", overrides), RIGS, SECONDS)
    return [
        f"rig: {name}.toml {' '.join(overrides)}".rstrip(),
        *(line for axis, figures in report.axes.items() for line in outline(_rounded(figures), f"axis {axis}")),
        *(f"tick {event.tick}: {event.text}" for event in report.events),
        f"ends after {report.ticks} ticks in {report.state}, {report.samples_lost} samples lost",
        f"trace_sha256: {report.trace_sha256}",
    ]


def _rounded(figures: dict[str, float]) -> dict[str, float]:
    return {name: float(f"{value:.4g}") for name, value in figures.items()}
