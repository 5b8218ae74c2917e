"""Motions that decide as they go: each tick they are asked where the axes should be next, and may look at readings."""
