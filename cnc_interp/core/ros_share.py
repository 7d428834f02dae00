"""Where ROS packages keep their files, and where this one has its machines and parameters."""

import os
import sys
from pathlib import Path


def share_directory(package: str) -> Path:
    """Return the data folder of a package, beside Python too; raises LookupError without it."""
    beside_python = Path(sys.prefix, 'share', package)  # installed by pip, also without ROS
    if 'AMENT_PREFIX_PATH' not in os.environ and beside_python.is_dir():
        return beside_python
    from ament_index_python.packages import get_package_share_directory

    os.environ.setdefault('AMENT_PREFIX_PATH', sys.prefix)
    return Path(get_package_share_directory(package))


def config_directory() -> Path:
    """Return the folder ``config``: beside the package, or in the ROS share."""
    source = Path(__file__).resolve().parents[2] / 'config'
    return source if source.is_dir() else share_directory('cnc_interp') / 'config'
