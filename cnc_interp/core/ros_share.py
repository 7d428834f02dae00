"""Where ROS packages keep their data files."""

from __future__ import annotations

import os
import sys
from pathlib import Path


def share_directory(package: str) -> Path:
    """
    Return the folder of the data files of an installed package.

    Without ``AMENT_PREFIX_PATH`` it is looked for where Python is installed: a command of a
    virtual environment works without anything being sourced.

    Raises
    ------
    LookupError
        If the package is not installed.

    """
    from ament_index_python.packages import get_package_share_directory

    os.environ.setdefault('AMENT_PREFIX_PATH', sys.prefix)
    return Path(get_package_share_directory(package))
