"""The mathematics: estimators, laws, trajectories, stability. Floats or arrays; no clock, no I/O."""
