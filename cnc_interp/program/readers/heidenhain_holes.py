"""Holes of Heidenhain plain text, drilled, tapped, bored or milled by the defined cycle."""

import re
from cmath import exp
from collections.abc import Callable

import numpy as np

from cnc_interp.core import MINUTE, MM, FloatArray
from cnc_interp.program.execution.context import Execution
from cnc_interp.program.execution.setup_words import cutter_of
from cnc_interp.program.geometry.arcs import PLANES
from cnc_interp.program.motion.cycles import Hole, dwell_of, go_along, make_hole, pecks_of
from cnc_interp.program.text.expressions import formula
from cnc_interp.program.text.words import BlockWords

#: Direction in which the tool of cycle 204 is shifted, by Q214; smallest circle [m].
_SIDES, _SAME = {1.0: (-1, 0), 2.0: (0, -1), 3.0: (1, 0), 4.0: (0, 1)}, 1e-9
#: Gap to the last peck on return, and retract to break a chip [m].
_NEAR, _BREAK = 0.6 * MM, 0.2 * MM


class HeidenhainHoles:
    """Makes holes by cycles with sizes in Q parameters; ``execute``: executes the words."""

    def __init__(self, at: Execution, execute: Callable[[BlockWords], None]):
        self.at, self.mover, self.variables, self.execute = at, at.mover, at.variables, execute
        self.fault, self.demand, self.refuse_if = at.fault, at.demand, at.refuse_if
        self.notice = at.notice
        self.cycle = 0  # number of the cycle that is defined

    def define(self, number: int, part: str | None, rest: str) -> None:
        """Read the number of a cycle; older cycles give their dimensions in separate lines."""
        self.cycle = number
        names = {'SET UP': 'Q200', 'DEPTH': 'Q201', 'PECKG': 'Q202', 'DWELL': 'Q211', 'F': 'Q206'}
        if part == '0':
            for name in ('Q203', 'Q204', 'Q210', 'Q211', 'Q202'):
                self.variables.set_name(name, 0.0)
        for word, name in names.items():
            if part not in (None, '0') and (found := re.fullmatch(rf'{word}\s*(\S+)', rest)):
                self.variables.set_name(name, formula(found[1], self.variables))

    def drill(self) -> None:
        """Make a hole at the current position with the defined cycle."""
        mover, unit, axis = self.mover, self.mover.unit, PLANES[self.mover.plane][2]
        self.demand(self.cycle, 'no cycle is defined; write CYCL DEF', 'CYCL CALL')
        if mover.frames.factor[axis] < 0.0 or self.cycle in (204, 208):
            mover.demand_no_scale(f'CYCL DEF {self.cycle}')

        def of(name: str) -> float:
            return self.variables.named(name) if self.variables.exists(name) else 0.0

        if self.cycle in (204, 208):
            self._bore(of)
            return
        self.refuse_if(
            self.cycle == 240 and of('Q343'),
            'a depth by the diameter is not supported; write Q201',
            'Q343',
        )
        surface = of('Q203') * unit if self.cycle >= 200 else float(mover.here()[axis])
        if self.cycle < 200:
            surface -= of('Q200') * unit  # the tool is at the clearance height
        bottom, retract = surface + of('Q201') * unit, surface + of('Q200') * unit
        self.demand(
            bottom < retract, 'the depth Q201 must be below the surface', f'CYCL DEF {self.cycle}'
        )
        clear, step = surface + max(of('Q204'), of('Q200')) * unit, of('Q202') * unit
        pecks: list[float] = []
        if self.cycle in (1, 200, 203, 205) and step > 0.0:
            less, least = of('Q212') * unit, of('Q205') * unit
            pecks = pecks_of(
                surface,
                bottom,
                step,
                lambda text: self.fault(text, 'Q202'),
                lambda stroke, _: max(stroke - less, least, 1e-6),
            )
        taps = self.cycle in (2, 206, 207)
        if taps:
            mover.tell_tapping(f'CYCL DEF {self.cycle}')
        reams = self.cycle == 201 and of('Q208') < np.inf
        breaks = self.cycle in (203, 205) and (of('Q213') > 0.0 or of('Q257') > 0.0)
        here = mover.here()
        go_along(mover, here, axis, retract, feed_given=True)
        feed = of('Q206') * unit / MINUTE
        if self.cycle == 207:
            feed = abs(of('Q239')) * unit * mover.spindle_speed / MINUTE
        hole = Hole(
            retract,
            bottom,
            clear,
            pecks,
            breaks,
            of('Q256') * unit or _BREAK if breaks else _NEAR,
            rests=of('Q211') > 0.0 or taps,
            dwell=dwell_of(mover, f'CYCL DEF {self.cycle}', of('Q211')),
            out=retract if taps or reams else None,
            feed=feed,
            feed_out=of('Q208') * unit / MINUTE if reams else None,
            reverse=('M3' if of('Q239') < 0.0 else 'M4') if taps else '',
        )
        make_hole(mover, hole, here, axis)

    def _bore(self, of: Callable[[str], float]) -> None:
        """Back-bore (204) with a shifted tool, or mill a hole (208)."""
        mover, unit, (a, b, axis) = self.mover, self.mover.unit, PLANES[self.mover.plane]
        name, kept, here = f'CYCL DEF {self.cycle}', mover.feedrate, mover.here()
        surface, gap = of('Q203') * unit, of('Q200') * unit
        retract, clear = surface + gap, surface + max(of('Q204') * unit, gap)

        def go(place: FloatArray, level: float, feed: str = '') -> None:
            mover.feedrate = of(feed) * unit / MINUTE if feed else np.inf
            self.demand(mover.feedrate > 0.0, f'the feed {feed} is missing', name)
            go_along(mover, place, axis, level, True, mover.feedrate == np.inf)

        aside, depth = here.copy(), of('Q249' if self.cycle == 204 else 'Q201') * unit
        if self.cycle == 204:
            side = _SIDES.get(of('Q214'))
            if side is None or not depth > 0.0:
                raise self.fault('write Q214 from 1 to 4, and the depth Q249 above 0', name)
            aside[[a, b]] += np.array(side) * of('Q251') * unit
            edge = surface - (of('Q250') + of('Q252')) * unit
            for place, level, feed in (
                (here, retract, ''),
                (aside, retract, 'Q253'),
                (aside, edge - gap, 'Q253'),
                (here, edge - gap, 'Q253'),
                (here, edge + depth, 'Q254'),
            ):
                go(place, level, feed)
            mover.targets.stop_here()
            for place, level in ((here, edge - gap), (aside, edge - gap), (aside, retract)):
                go(place, level, 'Q253')
        else:
            cutter = cutter_of(self.at, BlockWords()).radius
            radius, pitch = 0.5 * of('Q335') * unit - cutter, of('Q334') * unit
            self.demand(
                radius >= 0.0 and depth < 0.0 < pitch,
                'write Q335 not below the diameter of the tool, Q334 above 0, and Q201 below 0',
                name,
            )
            self.refuse_if(
                radius > cutter and not of('Q342') > 0.0,
                'the hole is more than twice as wide as the tool; write Q342',
                name,
            )
            self.notice(name, 'begins above the hole, at the side of the first axis')
            aside[a] += radius
            go(here, retract)
            go(aside, retract, 'Q206')
            turns = (gap - depth) / pitch
            climbs = (of('Q351') >= 0.0) == (self.at.outputs.get('spindle') != 'M4')
            angle = turns * 2j * np.pi * (1 if climbs else -1)
            rim = aside.copy()
            rim[a], rim[b] = here[a] + radius * exp(angle).real, here[b] + radius * exp(angle).imag
            rim[axis] = surface + depth
            if radius > _SAME:
                for times in (np.ceil(turns - 1e-9), 1.0):
                    words = BlockWords(
                        g=['G3' if climbs else 'G2'], ways=dict.fromkeys('IJK', 'AC')
                    )
                    words.values = {'XYZ'[i]: rim[i] / unit for i in range(3)} | {
                        'P': float(times)
                    }
                    words.values |= {'IJK'[i]: here[i] / unit for i in (a, b)}
                    words.texts = dict.fromkeys(words.values, name)
                    self.execute(words)
            go(here, surface + depth, 'Q206')
            go(here, retract)
        go(here, clear)
        mover.feedrate = kept
