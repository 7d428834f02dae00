"""Variables of ROS 2 and Fast DDS that keep other computers from reaching the nodes."""

import os
from collections.abc import Mapping
from pathlib import Path

RANGE, PEERS = 'ROS_AUTOMATIC_DISCOVERY_RANGE', 'ROS_STATIC_PEERS'
#: Variables with which a user chooses transports. Any of them replaces our profile.
TRANSPORTS = ('FASTRTPS_DEFAULT_PROFILES_FILE', 'FASTDDS_BUILTIN_TRANSPORTS')
PROFILE = Path(__file__).with_name('this_host.xml')
SOCKETS = Path(__file__).with_name('this_host_sockets.xml')  #: Profile without shared memory.


def variables_of_this_host(environment: Mapping[str, str]) -> dict[str, str]:
    """Return variables that bind ROS to 127.0.0.1, which the discovery range alone does not."""
    if environment.get(PEERS) or environment.get(RANGE, 'LOCALHOST') != 'LOCALHOST':
        return {}
    found = {RANGE: 'LOCALHOST'}
    if not any(environment.get(name) for name in TRANSPORTS):
        found[TRANSPORTS[0]] = str(PROFILE)
    return found


def stay_on_this_host() -> None:
    """Restrict ROS to this computer, unless the environment of the user says otherwise."""
    os.environ.update(variables_of_this_host(os.environ))


def use_sockets_only() -> None:
    """Use no shared memory in this process, unless the user's environment chooses transports."""
    stay_on_this_host()
    if os.environ.get(TRANSPORTS[0]) == str(PROFILE):  # by the range, rmw_fastrtps would add it
        os.environ.update({TRANSPORTS[0]: str(SOCKETS), RANGE: 'SYSTEM_DEFAULT'})
