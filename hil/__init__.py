"""The control service: one pure control cycle and the shells that run it live, in lockstep, or from a recording."""

import os

# Nothing in hil calls BLAS (bit determinism forbids it). One thread, set before numpy is imported, saves each process
# 40 MB and an idle thread beside the real-time loop.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
