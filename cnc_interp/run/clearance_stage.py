"""The stage that checks clearances: after the axes, before the feed planner; only with a scene."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from cnc_interp.core import BoolArray, IntArray
from cnc_interp.kinematics.axis_path import AxisPath
from cnc_interp.machine_model.machine import Machine
from cnc_interp.program.blocks import Blocks
from cnc_interp.program.blocks.functions import Functions
from cnc_interp.settings.options import Settings

if TYPE_CHECKING:
    from cnc_interp.collision.hits import Hit
    from cnc_interp.collision.path_clearance import Certificates, PathClearance

REFUSE, WARN = 'refuse', 'warn'


def clearance_of(machine: Machine, settings: Settings, most_hits: int = 0) -> PathClearance | None:
    """Return the check of a machine with the scene of the settings; None without one."""
    if settings.scene is None:
        return None
    from cnc_interp.collision.path_clearance import MOST_HITS, PathClearance
    from cnc_interp.collision.scene_file import read_scene

    return PathClearance(machine, read_scene(settings.scene), most_hits or MOST_HITS)


class ClearanceStage:
    """Checks a program while it is planned: ``hits`` so far, and certificates by ``check``."""

    def __init__(self, clearance: PathClearance, mode: str):
        self.clearance, self.mode = clearance, mode
        self.hits: list[Hit] = []
        self._rapid: BoolArray = np.zeros(0, dtype=np.bool_)
        self._line: IntArray = np.zeros(0, dtype=np.int64)

    @staticmethod
    def of(machine: Machine, settings: Settings) -> ClearanceStage | None:
        clearance = clearance_of(machine, settings)
        return None if clearance is None else ClearanceStage(clearance, settings.collision)

    @property
    def refused(self) -> bool:
        return bool(self.hits) and self.mode == REFUSE

    def rows(self, blocks: Blocks, functions: Functions | None = None) -> None:
        """Take further rows of the program, and its functions so far."""
        self._rapid = np.concatenate([self._rapid, blocks.rapid])
        self._line = np.concatenate([self._line, blocks.line_number])
        if functions is not None:
            self.clearance.call_tools(functions)

    def check(self, path: AxisPath) -> Certificates:
        rapid = self._rapid[path.cell_block]
        hits, found = self.clearance.push(path, rapid, lambda row: int(self._line[row]))
        self.hits += hits
        return found

    def require(self, source: str) -> None:
        """Refuse a program that hits something, with a line for each hit."""
        from cnc_interp.collision.hits import CollisionsError

        if self.refused:
            raise CollisionsError(self.hits, self.clearance.machine, source)

    def summary(self) -> dict[str, Any]:
        figures, machine = self.clearance.figures, self.clearance.machine
        return {
            'scene': str(self.clearance.scene.source),
            'mode': self.mode,
            'bodies': len(self.clearance.scene.bodies),
            'pairs': figures.pairs,
            'intervals': figures.intervals,
            'certificates': figures.certificates,
            'hits': [hit.text(machine) for hit in self.hits],
        }
