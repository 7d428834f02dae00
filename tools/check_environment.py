"""Check that the environment holds together: every compiled part of it loads, ROS included."""

from __future__ import annotations

import importlib
import sys

COMPILED = ('numpy', 'scipy.interpolate', 'numba', 'ruckig', 'yaml', 'apsw', 'rclpy')
INTERFACE_PACKAGES = ('cnc_interp_msgs', 'sensor_msgs', 'diagnostic_msgs', 'std_srvs')


def check_imports() -> None:
    """Import what the project is built on; raises ImportError for what is missing."""
    for name in (*COMPILED, 'cnc_interp'):
        importlib.import_module(name)


def check_type_support() -> None:
    """Load the C type support of the interface packages, which importing alone does not."""
    for package in INTERFACE_PACKAGES:
        for kind in ('msg', 'srv', 'action'):
            try:
                module = importlib.import_module(f'{package}.{kind}')
            except ModuleNotFoundError as missing:
                if kind == 'msg' and package != 'std_srvs':
                    raise ImportError(f'{package}.{kind} is missing') from missing
                continue
            for name in dir(module):
                loader = getattr(type(getattr(module, name)), '__import_type_support__', None)
                if loader is not None:
                    loader()


if __name__ == '__main__':
    try:
        check_imports()
        check_type_support()
    except Exception as reason:  # a broken binary raises anything from OSError to SystemError
        sys.exit(f'{type(reason).__name__}: {reason}')
    print('environment complete')
