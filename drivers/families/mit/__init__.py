"""Drives of the MIT kind: Damiao, CubeMars (T-Motor) AK, RobStride."""
