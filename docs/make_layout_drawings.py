"""Draw where the offsets of a machine file lead, for each layout: ``docs/pictures/layouts.png``.

python docs/make_layout_drawings.py
"""

from __future__ import annotations

from typing import Any

import matplotlib as mpl
import numpy as np
from make_pictures import BLUE, INK, ORANGE, PICTURES, QUIET, STYLE
from matplotlib import pyplot as plt

from cnc_interp.convert.machine_questions import LAYOUTS
from cnc_interp.core import FloatArray
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.machine_entries import GEOMETRY, needed_offsets

#: Steps of a drawing in place of the offsets of a file, so that all can be seen [-].
STEPS = {
    'workpiece_offset_mm': (0.9, -0.7, 0.8),
    'secondary_offset_mm': (0.0, 0.5, 1.3),
    'primary_offset_mm': (1.2, 0.6, 0.9),
    'tip_to_secondary_pivot_mm': (0.0, 0.0, 1.1),
    'secondary_to_primary_pivot_mm': (0.5, 0.0, 1.2),
}
TIP = np.array([-1.6, 0.0, 1.8])  #: Of the tool in the drawing.


def ring(axes: Any, place: FloatArray, about: FloatArray, name: str) -> None:
    """Draw a rotary axis: a circle, and its direction."""
    side = np.linalg.svd(about[None])[2][1:]
    turn = np.linspace(0.0, 1.7 * np.pi, 60)
    circle = place + 0.35 * (np.cos(turn)[:, None] * side[0] + np.sin(turn)[:, None] * side[1])
    axes.plot(*circle.T, color=BLUE, lw=2)
    ends = place + 0.6 * np.array([-1.0, 1.0])[:, None] * about
    axes.plot(*ends.T, color=BLUE, lw=1, ls=':')
    axes.text(*(ends[1] + 0.12), name, color=BLUE, weight='bold')


def step(axes: Any, start: FloatArray, key: str, downwards: bool = False) -> FloatArray:
    """Draw an offset as an arrow with its key; return its end."""
    end = start + np.array(STEPS[key])
    axes.quiver(*start, *(end - start), color=ORANGE, arrow_length_ratio=0.12, lw=1.6)
    axes.text(*(0.5 * (start + end)), ' ' + key.removesuffix('_mm'), fontsize=6.5, color=INK)
    return end


def draw(axes: Any, machine: Machine, title: str) -> None:
    """Draw one layout."""
    axes.set_title(title, fontsize=9)
    tool, zero = TIP, np.zeros(3)
    axes.text(*(zero + (0.0, 0.0, -0.35)), 'machine zero', fontsize=7)
    axes.plot(*zero[:, None], 's', color=INK, ms=5)
    if not machine.has_rotary:
        axes.quiver(*zero, 1.2, 0.6, 0.9, color=ORANGE, arrow_length_ratio=0.12, lw=1.6)
        axes.text(0.6, 0.3, 0.45, ' workpiece_zero', fontsize=6.5)
        zero = np.array([1.2, 0.6, 0.9])
    else:
        locked = [axis.locked for axis in machine.axes[3:5]]
        needed = needed_offsets(machine.rotary_on_head, any(locked))
        rows = list(zip(machine.axis_names[3:5], machine.rotary_direction, strict=True))
        for k, key in ((0, GEOMETRY[2]), (1, GEOMETRY[1])):
            if key in needed:
                zero = step(axes, zero, key)
            if not machine.rotary_on_head[k] and not locked[k]:
                ring(axes, zero, rows[k][1], rows[k][0])
        if GEOMETRY[0] in needed:
            zero = step(axes, zero, GEOMETRY[0])
        for k, key in ((1, GEOMETRY[3]), (0, GEOMETRY[4])):
            if key in needed:
                tool = step(axes, tool, key)
            if machine.rotary_on_head[k] and not locked[k]:
                ring(axes, tool, rows[k][1], rows[k][0])
    axes.plot(*np.stack([TIP, TIP + (0.0, 0.0, 0.7)]).T, color=QUIET, lw=4)
    axes.text(*(TIP + (-0.2, 0.0, -0.35)), 'tool tip', fontsize=7)
    axes.plot(*zero[:, None], 'o', color=INK, ms=5)
    axes.text(*(zero + (0.1, 0.0, 0.15)), 'workpiece zero', fontsize=7)
    axes.set(xlim=(-2.2, 3.2), ylim=(-1.6, 1.6), zlim=(-0.5, 4.9))
    axes.set_box_aspect((5.4, 3.2, 5.4), zoom=1.3)
    axes.view_init(18, -62)
    axes.set_axis_off()


def main() -> None:
    """Draw all layouts side by side."""
    mpl.use('agg')
    with mpl.rc_context(STYLE):
        figure = plt.figure(figsize=(11, 7.4))
        for k, (title, name) in enumerate(LAYOUTS.items()):
            draw(figure.add_subplot(2, 3, k + 1, projection='3d'), Machine.load(name), title)
        figure.subplots_adjust(0.0, 0.0, 1.0, 0.95, 0.02, 0.04)
        figure.savefig(PICTURES / 'layouts.png', dpi=110)


if __name__ == '__main__':
    main()
