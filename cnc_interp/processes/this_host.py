"""Set environment variables of ROS 2 and Fast DDS so that other computers cannot reach nodes."""

import os
from collections.abc import Mapping
from pathlib import Path

RANGE, PEERS = 'ROS_AUTOMATIC_DISCOVERY_RANGE', 'ROS_STATIC_PEERS'
#: Variables with which a user chooses transports. If one is set, our profile is not used.
TRANSPORTS = ('FASTRTPS_DEFAULT_PROFILES_FILE', 'FASTDDS_BUILTIN_TRANSPORTS')
PROFILE = Path(__file__).with_name('this_host.xml')


def variables_of_this_host(environment: Mapping[str, str]) -> dict[str, str]:
    """Return variables that bind ROS to 127.0.0.1; its discovery range alone does not do so."""
    if environment.get(PEERS) or environment.get(RANGE, 'LOCALHOST') != 'LOCALHOST':
        return {}
    fast = 'fastrtps' in (environment.get('RMW_IMPLEMENTATION') or 'rmw_fastrtps_cpp')
    if not fast or any(environment.get(name) for name in TRANSPORTS):
        return {RANGE: 'LOCALHOST'}
    # With LOCALHOST, rmw_fastrtps would add shared memory to the sockets of the profile.
    return {RANGE: 'SYSTEM_DEFAULT', TRANSPORTS[0]: str(PROFILE)}


def stay_on_this_host() -> None:
    """Restrict ROS to this computer, unless the user's environment sets another range."""
    os.environ.update(variables_of_this_host(os.environ))
