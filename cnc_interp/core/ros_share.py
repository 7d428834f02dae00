"""Where ROS packages keep their data files."""

from __future__ import annotations

import os
import sys
from pathlib import Path


def share_directory(package: str) -> Path:
    """
    Return the folder of the data files of an installed package; raises LookupError without it.

    Without ``AMENT_PREFIX_PATH`` it is searched beside Python: no script need be sourced.
    """
    beside_python = Path(sys.prefix, 'share', package)  # installed by pip, also without ROS
    if 'AMENT_PREFIX_PATH' not in os.environ and beside_python.is_dir():
        return beside_python
    from ament_index_python.packages import get_package_share_directory

    os.environ.setdefault('AMENT_PREFIX_PATH', sys.prefix)
    return Path(get_package_share_directory(package))
