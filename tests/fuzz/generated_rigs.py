"""Rigs as `hil new` writes them, from drawn answers, with drawn changes; some of which cannot be."""

import random

LAYOUTS = ("stage_fd", "stage_fd", "stage_classic", "cia402", "moteus")
NAMES = (["x"], ["x", "y"], ["x", "y", "z"], ["x", "y", "z", "theta"])
LAWS = ("pd-feedforward", "robust-pd", "pid", "structured-kalman", "presliding-kalman")
CHANGES = (
    ("law.name={}", LAWS),
    ("task.kind={}", ("hold", "sine", "injection")),
    ("axes.x.limits.speed={}", (1e-4, 0.01, 0.2, 5.0)),
    ("axes.x.limits.force_rate={}", (1.0, 1e3, 1e6)),
    ("axes.x.model.torque_lag={}", (0.0, 1e-4, 2e-3, 0.5)),
    ("axes.x.model.mode_frequency_hz={}", (20.0, 150.0, 480.0)),
    ("axes.x.model.viscous={}", (0.0, 3.0, 500.0)),
    ("axes.x.model.presliding={}", ("[1e-6,5e-6]", "[5e-6,1e-6]")),
    ("rate_hz={}", (100, 333, 500, 2000, 20000)),
    ("drives.watchdog_s={}", (0.002, 0.02, 0.5)),
    ("plant.friction_scale={}", (0.0, 0.5, 3.0)),
    ("plant.stage={}", ("crossed-roller", "ideal", "unheard-of")),
    ("safety.stop_s={}", (0.01, 0.2, 3.0)),
    ("bus.bitrate={}", (125000, 500000, 1000000)),
    ("telemetry.key={}", ("lab/left", "*", "")),
)


def new_words(chance: random.Random) -> list[str]:
    """Options of `hil new`: masses over four decades, travel, encoders, drives."""
    axes = chance.choice(NAMES)

    def drawn(low: float, high: float) -> str:
        return f"{10 ** chance.uniform(low, high):.3g}"

    words = ["--axes", ",".join(axes), "--layout", chance.choice(LAYOUTS), "--mass", drawn(-2.0, 1.5)]
    words += ["--travel", drawn(-3.0, 0.0), "--encoder", drawn(-9.0, -5.0), "--force", drawn(-1.0, 2.5)]
    words += ["--vertical", "z"] if "z" in axes and chance.random() < 0.7 else []
    words += ["--rotary", "theta"] if "theta" in axes else []
    return words + (["--rate", f"{chance.choice((200, 500, 1000, 4000))}"] if chance.random() < 0.3 else [])


def changes(chance: random.Random) -> list[str]:
    """Words of `--set`, none to three."""
    found = chance.sample(CHANGES, chance.randrange(4))
    return [key.format(chance.choice(values)) for key, values in found]
