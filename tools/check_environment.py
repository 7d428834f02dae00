"""Check that every compiled part of the environment loads, ROS included."""

from __future__ import annotations

import importlib
import sys

COMPILED = ('numpy', 'scipy.interpolate', 'numba', 'ruckig', 'yaml', 'apsw', 'rclpy')
INTERFACE_PACKAGES = ('cnc_interp_msgs', 'sensor_msgs', 'diagnostic_msgs')
INTERFACES_WITH_PARTS = (('cnc_interp_msgs.action', 'RunProgram'), ('std_srvs.srv', 'Trigger'))


def check_imports() -> None:
    """Import the packages that the project needs; ImportError names a missing one."""
    for name in (*COMPILED, 'cnc_interp'):
        importlib.import_module(name)


def check_messages() -> None:
    """Serialise a message of each type, which loads all libraries of the type."""
    from rclpy.serialization import deserialize_message, serialize_message

    for package in INTERFACE_PACKAGES:
        module = importlib.import_module(f'{package}.msg')
        for name in sorted(vars(module)):
            kind = getattr(module, name)
            if isinstance(kind, type):
                deserialize_message(serialize_message(kind()), kind)
    for module_name, name in INTERFACES_WITH_PARTS:
        type(getattr(importlib.import_module(module_name), name)).__import_type_support__()


if __name__ == '__main__':
    try:
        check_imports()
        check_messages()
    except Exception as reason:  # a broken binary raises anything from OSError to SystemError
        sys.exit(f'{type(reason).__name__}: {reason}')
    print('environment complete')
