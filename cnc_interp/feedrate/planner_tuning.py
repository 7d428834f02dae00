"""Settings of the feed planner, and the cells that it keeps from an older plan."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from cnc_interp.core import FloatArray
from cnc_interp.machine_model.machine import Machine
from cnc_interp.settings.options import Settings

if TYPE_CHECKING:
    from cnc_interp.feedrate.tool_limit import ToolLimit


@dataclass(frozen=True)
class PlanOptions:
    passes: int = 6  #: Largest number of corrections of one stretch.
    cell_time: tuple[float, float] = (2e-4, 6e-3)  #: Shortest and longest wanted cell time [s].
    share: float = 1 / 64  #: Wanted cell time as a part of the duration of the stretch [-].
    bend: float = 0.0025  #: Largest nonlinearity of a limit inside a cell, over the limit [-].
    gap: float = 5e-5  #: Accepted gap to the optimum, relative to the time [-].
    window_ratio: float = 2.5  #: Length of a window in horizons; one is committed later [-].
    window_cells: int = 4000  #: Largest number of path cells in one window.
    bound: bool = True  #: Whether the least time is computed; it does not change the law.
    below_ceiling: bool = False  #: Whether the jerk stage starts below the ceiling.
    reserve: float = 0.029  #: Part of a limit that is kept free where a law could not brake [-].

    def finer(self) -> PlanOptions:
        return replace(
            self,
            cell_time=(self.cell_time[0] / 2, self.cell_time[1] / 2),
            share=self.share / 2,
            bend=self.bend / 2,
            below_ceiling=True,
        )


@dataclass(frozen=True)
class KeptCells:
    """The first cells of a stretch in an older plan, kept so that the older law stays feasible."""

    ends: FloatArray  #: (k,): Path positions at the ends of the cells [m].
    scale: FloatArray  #: (k, 4, n_axes): Parts of the limits that these cells may use [-].
    m: FloatArray  #: (k,): Coefficients of the older law, the start values of the solver [m2/s2].
    tool: FloatArray | None = None  #: (2, k): Parts of the tool limit that they may use [-].

    def before(self, s: float) -> KeptCells:
        count = int(np.searchsorted(self.ends, s))
        tool = None if self.tool is None else self.tool[:, :count]
        return KeptCells(self.ends[:count], self.scale[:count], self.m[:count], tool)


def wanted_tool(machine: Machine, settings: Settings) -> ToolLimit | None:
    """Return the limit on the error at the tool that the settings request, or None.

    Raises MachineError if the model does not fit the machine.
    """
    if settings.tool_error is None:
        return None
    # The simulated drives take a fifth of a second to load, and few plans need them.
    from cnc_interp.feedrate.tool_limit import ToolLimit

    return ToolLimit.of_settings(machine, settings)


def tool_warnings(machine: Machine, settings: Settings) -> list[str]:
    """Return warnings about the tool limit for the operator; raises as ``wanted_tool``."""
    tool = wanted_tool(machine, settings)
    return [] if tool is None else tool.warnings
