"""cnc_interp: a 5-axis CNC interpolator whose every emitted setpoint is proven.

The names below are the Python library. It works in SI units, without ROS, files or state. Each
name is loaded at its first use, so that commands start without delay.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from cnc_interp.cam.cutter import Cutter
    from cnc_interp.cam.iso_scallop import IsoScallopOptions, iso_scallop_paths
    from cnc_interp.cam.shapes import BSplineSurface
    from cnc_interp.core import InterpError
    from cnc_interp.feedrate.motion_law import axis_motion
    from cnc_interp.feedrate.planner_tuning import PlanOptions
    from cnc_interp.feedrate.planning_windows import plan_path
    from cnc_interp.kinematics.axis_path import evaluate
    from cnc_interp.library import Plan, axis_path_from, check, plan, plan_program, smooth_path
    from cnc_interp.machine.simulated_drives import simulate
    from cnc_interp.machine_model.machine import Machine
    from cnc_interp.machine_model.transform_port import Transform
    from cnc_interp.program.blocks import Blocks
    from cnc_interp.program.reading import Program, read_program, read_text
    from cnc_interp.settings.options import Settings

__version__ = '1.0.0'
__all__ = [
    'BSplineSurface',
    'Blocks',
    'Cutter',
    'InterpError',
    'IsoScallopOptions',
    'Machine',
    'Plan',
    'PlanOptions',
    'Program',
    'Settings',
    'Transform',
    'axis_motion',
    'axis_path_from',
    'check',
    'evaluate',
    'iso_scallop_paths',
    'plan',
    'plan_path',
    'plan_program',
    'read_program',
    'read_text',
    'simulate',
    'smooth_path',
]
#: Modules that define these names.
_HOMES = {
    'cam.cutter': 'Cutter',
    'cam.iso_scallop': 'IsoScallopOptions iso_scallop_paths',
    'cam.shapes': 'BSplineSurface',
    'core': 'InterpError',
    'feedrate.planning_windows': 'plan_path',
    'feedrate.motion_law': 'axis_motion',
    'feedrate.planner_tuning': 'PlanOptions',
    'kinematics.axis_path': 'evaluate',
    'library': 'Plan axis_path_from check plan plan_program smooth_path',
    'machine.simulated_drives': 'simulate',
    'machine_model.machine': 'Machine',
    'machine_model.transform_port': 'Transform',
    'program.blocks': 'Blocks',
    'program.reading': 'Program read_program read_text',
    'settings.options': 'Settings',
}


if not TYPE_CHECKING:  # else any name would be one

    def __getattr__(name: str) -> Any:
        for home, names in _HOMES.items():
            if name in names.split():
                found = globals()[name] = getattr(import_module(f'cnc_interp.{home}'), name)
                return found
        raise AttributeError(f'module {__name__!r} has no attribute {name!r}')

    def __dir__() -> list[str]:
        return sorted({*globals(), *__all__})
