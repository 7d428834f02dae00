"""Records: state that kernels and Python share, with a name for each value."""

from collections.abc import Sequence
from typing import Any, TypeVar, get_args, get_type_hints

import numpy as np

Kind = TypeVar('Kind')


def record(kind: type[Kind]) -> Sequence[Kind]:
    """Return one record of zeros with the fields of a class, in an array of length 1.

    ``record(kind)[0]`` has the annotated fields as attributes, in Python and in kernels, and both
    write to the same memory. ``float``, ``int`` and ``bool`` are single values;
    ``Annotated[FloatArray, n]`` is an array of n numbers.
    """
    fields: list[tuple[Any, ...]] = [
        (name, np.float64, get_args(hint)[-1:]) if get_args(hint) else (name, hint)
        for name, hint in get_type_hints(kind, include_extras=True).items()
    ]
    found: Any = np.zeros(1, np.dtype(fields, align=True)).view(np.recarray)
    return found
