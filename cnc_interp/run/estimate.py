"""Estimate the time of a program: it is planned as usual, but its motion is not sampled."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.transform_port import Transform
from cnc_interp.program import ProgramStream
from cnc_interp.run.planning_chain import planned
from cnc_interp.run.program_times import ProgramTimes, ToolSection
from cnc_interp.settings.options import Settings


class _TimesOnly(ProgramTimes):
    setpoints = None

    def segments(self, _: Any) -> None:
        """Do nothing: the time of segments is not known yet."""

    certificates = segments


@dataclass(frozen=True)
class Estimate:
    program: str
    machine: str
    sections: list[ToolSection]
    stops: int  #: Number of waits for the operator; they take an unknown time.
    #: Error of motion times in recorded runs (95 %), as a share [-]; 0 if unknown.
    scatter: float
    #: Speeds of the spindle for which no start and stop times are measured [rev/min].
    other_speeds: tuple[float, ...] = ()

    @property
    def total(self) -> float:
        """Time of the program, without waits for the operator [s]."""
        return sum(one.times.total + one.change for one in self.sections)

    @property
    def half_width(self) -> float:
        """Half width of the 95 % interval of the total time [s]; 0: unknown.

        Spindle times at speeds that were not measured may be wrong by 50 %.
        """
        motion = sum(one.times.cutting + one.times.rapid for one in self.sections)
        spindle = sum(one.times.spindle for one in self.sections if self.other_speeds)
        return math.hypot(self.scatter * motion, 0.5 * spindle)

    def to_json(self) -> dict[str, Any]:
        return {
            'program': self.program,
            'machine': self.machine,
            'total_s': self.total,
            'half_width_s': self.half_width or None,
            'stops': self.stops,
            'other_spindle_speeds': list(self.other_speeds),
            'tools': [one.to_json() for one in self.sections],
        }


def estimate(
    stream: ProgramStream,
    machine: Machine,
    settings: Settings,
    processes: int = 1,
    progress: Callable[[float], None] = lambda _: None,
    overrides: tuple[float, float] = (1.0, 1.0),
) -> Estimate:
    """Return the estimated time of a program; raises InterpError if it cannot be planned.

    ``overrides``: factors on the feed and on the speed of rapids [-].
    """
    times, geometry = _TimesOnly(), Transform.of(machine)
    with planned(stream, geometry, settings, times, None, processes, progress, overrides):
        pass
    name = machine.file or machine.name
    sections = times.sections(stream.functions, machine, stream.source)
    scatter = 0.0 if machine.pace is None else machine.pace.scatter
    measured = machine.standstill.speed
    speeds = stream.functions.speeds(machine.signals) if measured else ()
    others = tuple(float(speed) for speed in speeds if abs(speed - measured) > 0.1 * measured)
    stops = times.stops + stream.waits_first
    return Estimate(stream.source, name, sections, stops, scatter, others)
