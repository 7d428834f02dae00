"""Variables of ROS 2 and Fast DDS that keep other computers from reaching the nodes."""

import os
from collections.abc import Mapping
from pathlib import Path

RANGE, PEERS = 'ROS_AUTOMATIC_DISCOVERY_RANGE', 'ROS_STATIC_PEERS'
#: Variables with which a user chooses transports. Any of them replaces our profile.
TRANSPORTS = ('FASTRTPS_DEFAULT_PROFILES_FILE', 'FASTDDS_BUILTIN_TRANSPORTS')
PROFILE = Path(__file__).with_name('this_host.xml')


def variables_of_this_host(environment: Mapping[str, str]) -> dict[str, str]:
    """Return variables that bind ROS to 127.0.0.1, which the discovery range alone does not."""
    if environment.get(PEERS) or environment.get(RANGE, 'LOCALHOST') != 'LOCALHOST':
        return {}
    fast = 'fastrtps' in (environment.get('RMW_IMPLEMENTATION') or 'rmw_fastrtps_cpp')
    if not fast or any(environment.get(name) for name in TRANSPORTS):
        return {RANGE: 'LOCALHOST'}
    # With LOCALHOST, rmw_fastrtps would add shared memory to the sockets of the profile.
    return {RANGE: 'SYSTEM_DEFAULT', TRANSPORTS[0]: str(PROFILE)}


def stay_on_this_host() -> None:
    """Restrict ROS to this computer, unless the environment of the user says otherwise."""
    os.environ.update(variables_of_this_host(os.environ))
