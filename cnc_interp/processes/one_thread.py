"""One thread for OpenBLAS: for our small matrices more would only wait, and busily."""

import os

THREADS = 'OPENBLAS_NUM_THREADS'  #: Read when NumPy loads OpenBLAS.


def use_one_thread() -> None:
    os.environ.setdefault(THREADS, '1')
