"""LinuxCNC's own configurations: each converts and loads in HAL, or is refused with a reason."""

import re
import sys
from pathlib import Path

import pytest

sys.path.append(str(Path(__file__).parents[2] / 'benchmarks'))

import hal_session
import linuxcnc_configs

pytestmark = pytest.mark.thorough

#: Configurations that LinuxCNC's package installs.
SAMPLES = Path('/usr/share/doc/linuxcnc/examples/sample-configs')
#: Why a configuration may be refused: files in Tcl, other kinematics, axes that no machine has.
REFUSED = (
    r'is Tcl, which is not read',
    r'KINEMATICS: \w+ is not known',
    r'COORDINATES: trivkins with (?!XYZ[ABC]?[UVW]?:)\w+: the axes must be XYZ',
    r'no KINEMATICS in \[KINS\]; give the INI file of LinuxCNC 2\.8 or later',
    r'MAX_VELOCITY: missing in \[AXIS_\w\]',
    r'\.hal: cannot be opened: No such file',
    r'no HAL file names joint\.\d\.motor-pos-cmd',
)


@pytest.mark.parametrize('folder', ['by_interface/parport', 'sim'])
def test_every_configuration_of_linuxcnc_loads_or_says_why_not(folder):
    reason = hal_session.why_not()
    if not reason and not (SAMPLES / folder).is_dir():
        reason = f'{SAMPLES / folder} is not installed (Debian: linuxcnc-doc-en)'
    if reason:
        pytest.skip(reason)
    found = [
        linuxcnc_configs.tried(ini, loads=True) for ini in linuxcnc_configs.inis(SAMPLES / folder)
    ]
    loaded = [each for each in found if each.reached == 'loaded']
    failed = [each for each in found if each.reached != 'loaded' and not each.refused]
    assert not failed
    assert len(loaded) > 0.4 * len(found)
    for each in found:
        assert each in loaded or any(re.search(why, each.why) for why in REFUSED), each
