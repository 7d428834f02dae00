"""Draw the signs of the geometric errors, for ``docs/geometric_errors.md``.

    python docs/make_error_sketch.py

writes ``docs/pictures/error_signs.png``. Needs matplotlib beside the package.
"""

from __future__ import annotations

from typing import Any

import matplotlib as mpl
import numpy as np
from make_pictures import BLUE, INK, ORANGE, PICTURES, QUIET, STYLE
from matplotlib import pyplot as plt
from matplotlib.patches import Arc, FancyArrowPatch

#: Directions of X Y Z on the paper.
ON_PAPER = np.array([[1.0, 0.0], [0.55, 0.42], [0.0, 1.0]])
#: What turns from one axis towards the next: the rotation, and from which axis to which.
TURNS = {'EAX': (1, 2, 0), 'EBX': (2, 0, 1), 'ECX': (0, 1, 2)}
#: Squareness: the line that turns, the line that it should be square to, and the sense.
SQUARE = {'C0Y': ('Y', 'X', 1), 'B0Z': ('Z', 'X', -1), 'A0Z': ('Z', 'Y', 1)}


def arrow(axes: Any, start: Any, end: Any, colour: str, **more: Any) -> None:
    """Draw an arrow between two points of the paper."""
    look = {'arrowstyle': '-|>', 'mutation_scale': 12, 'lw': 1.6, 'color': colour}
    axes.add_patch(FancyArrowPatch(start, end, shrinkA=0, shrinkB=0, **look | more))


def carriage(axes: Any) -> None:
    """Draw the tool tip while X moves, with its three displacements and three rotations."""
    arrow(axes, (-0.6, 0.0), (3.4, 0.0), QUIET, lw=1.2)
    axes.text(3.45, 0.0, 'X moves', color=QUIET, va='center')
    axes.plot([0], [0], 'o', color=INK, ms=4)
    for i, name in enumerate(('EXX', 'EYX', 'EZX')):
        tip = 1.7 * ON_PAPER[i]
        arrow(axes, (0.0, 0.0), tip, BLUE)
        axes.text(*(1.12 * tip + (0.0, 0.16 * (i == 0))), name, color=BLUE, ha='center')
    for name, (first, second, about) in TURNS.items():
        angle = np.linspace(0.15 * np.pi, 0.85 * np.pi, 40)
        ring = 0.3 * (np.cos(angle)[:, None] * ON_PAPER[first])
        ring = ring + 0.3 * np.sin(angle)[:, None] * ON_PAPER[second] + 1.1 * ON_PAPER[about]
        axes.plot(*ring.T, color=ORANGE, lw=1.6)
        arrow(axes, ring[-4], ring[-1], ORANGE)
        axes.text(*(ring.mean(axis=0) + (0.36, 0.12)), name, color=ORANGE, ha='center')
    axes.set_title('The tool over the workpiece while X moves', fontsize=9, color=INK)
    axes.set_xlim(-0.8, 4.2)


def square(axes: Any, name: str) -> None:
    """Draw a line that is not square to another, turned by a positive error."""
    turning, fixed, sense = SQUARE[name]
    arrow(axes, (0, 0), (1.6, 0), QUIET)
    arrow(axes, (0, 0), (0, 1.6), QUIET, ls='--')
    tilt = np.radians(14.0) * sense
    arrow(axes, (0, 0), (-1.6 * np.sin(tilt), 1.6 * np.cos(tilt)), BLUE)
    ends = sorted((90.0, 90.0 + np.degrees(tilt)))
    axes.add_patch(Arc((0, 0), 2.2, 2.2, theta1=ends[0], theta2=ends[1], color=ORANGE, lw=1.6))
    side = -1.5 * np.sin(tilt) - 0.1 * sense
    axes.text(side, 0.95, name, color=ORANGE, ha='right' if sense > 0 else 'left')
    axes.text(1.65, 0, fixed, color=QUIET, va='center')
    axes.text(-1.7 * np.sin(tilt), 1.7 * np.cos(tilt), turning, color=BLUE, ha='center')
    axes.set_xlim(-0.9, 1.9)


def main() -> None:
    """Write the picture."""
    mpl.rcParams.update(STYLE)
    figure, panels = plt.subplots(
        1, 4, figsize=(9.0, 2.6), gridspec_kw={'width_ratios': (2.2, 1, 1, 1)}
    )
    carriage(panels[0])
    for panel, name in zip(panels[1:], SQUARE, strict=True):
        square(panel, name)
        panel.set_title(f'{name} > 0', fontsize=9, color=INK)
    for panel in panels:
        panel.set_aspect('equal')
        panel.set_ylim(-0.25, 2.1)
        panel.axis('off')
    figure.tight_layout()
    figure.savefig(PICTURES / 'error_signs.png', dpi=160)


if __name__ == '__main__':
    main()
