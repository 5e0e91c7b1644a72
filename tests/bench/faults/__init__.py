"""Faults in flight: the flights share the cores, so linear algebra is to take no more than one each."""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before numpy is imported
