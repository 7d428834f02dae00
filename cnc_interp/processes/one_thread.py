"""Restrict OpenBLAS to one thread; for small matrices, further threads would only busy-wait."""

import os

THREADS = 'OPENBLAS_NUM_THREADS'  #: Read when NumPy loads OpenBLAS.


def use_one_thread() -> None:
    os.environ.setdefault(THREADS, '1')
