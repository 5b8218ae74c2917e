"""Sealed faults: drawn at random, hidden, told from a run's events alone, and only then compared with the truth."""
