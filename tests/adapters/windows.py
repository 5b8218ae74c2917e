"""What counts as in position where adapters are tested: 10 um (urad) on every axis."""

WINDOWS = [f"axes.{axis}.motion.window=1e-5" for axis in ("x", "y", "z", "theta")]
