"""Restrict OpenBLAS to one thread: with small matrices, other threads would only busy-wait."""

import os

THREADS = 'OPENBLAS_NUM_THREADS'  #: Environment variable; OpenBLAS reads it at its start.


def use_one_thread() -> None:
    os.environ.setdefault(THREADS, '1')
