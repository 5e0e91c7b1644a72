"""Faults in flight: each takes one core, since they share them, and no thread, which no fork takes along."""

import os

for _library in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
    os.environ.setdefault(_library, "1")  # before numpy is imported
