"""The control service: one pure control cycle and the shells that run it live, in lockstep, or from a recording."""
