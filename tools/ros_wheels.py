"""Point the CMake export files of the ROS wheels at the environment they are installed in."""

from __future__ import annotations

import re
import sys
import sysconfig
from pathlib import Path

import numpy as np

# The wheels carry the include directories of the machine that built them.
BUILD_MACHINE_PYTHON = re.compile(r'/opt/python/[^/";]+/include/python3\.\d+')
BUILD_MACHINE_NUMPY = re.compile(
    r'/opt/python/[^/";]+/lib/python3\.\d+/site-packages/numpy/(?:_core|core)/include'
)


def relocate(text: str, python_include: str, numpy_include: str) -> str:
    """Replace the include directories of the build machine in a CMake export file.

    Parameters
    ----------
    text : str
        Content of the export file.
    python_include, numpy_include : str
        Directories that hold ``Python.h`` and ``numpy/arrayobject.h`` here.

    Returns
    -------
    str
        The content with both directories replaced; unchanged when it names neither.

    """
    text = BUILD_MACHINE_NUMPY.sub(lambda _: numpy_include, text)
    return BUILD_MACHINE_PYTHON.sub(lambda _: python_include, text)


def relocate_exports(prefix: Path) -> int:
    """Relocate every CMake export file below ``prefix/share``; return how many were changed."""
    changed = 0
    for export in sorted(prefix.glob('share/*/cmake/*Export*.cmake')):
        before = export.read_text()
        after = relocate(before, sysconfig.get_path('include'), np.get_include())
        if after != before:
            export.write_text(after)
            changed += 1
    return changed


if __name__ == '__main__':
    print(f'{relocate_exports(Path(sys.prefix))} CMake export files relocated')
