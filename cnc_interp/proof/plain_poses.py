"""Tables of poses and recorded paths, read a second time for the proof."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator

import numpy as np

from cnc_interp.core import MM, FloatArray

#: The line, position [m], tool axis, spin [rad] and feed [m/s] of a pose.
Pose = tuple[int, FloatArray, FloatArray, float, float]
#: Start of a text with poses.
TABLE = re.compile(
    r'\s*(?:[xyz\s,;]+q[xyzw]\b|(?:header|poses):\s*$)', re.IGNORECASE | re.MULTILINE
)
_HEADER = re.compile(r'[XYZ\s,;]+(?:Q[XYZW][\s,;]*){4}(?:FEED)?[\s,;]*')


def poses_of(lines: list[str], feed: float, refuse: Callable[[str], Exception]) -> Iterator[Pose]:
    """Yield the poses of a text, given as lines in upper case with their comments."""
    told = [(k, line.strip(' ,;')) for k, line in enumerate(lines, start=1) if line.strip()]
    if _HEADER.fullmatch(told[0][1]):
        names = re.split(r'[\s,;]+', told[0][1])
        for number, line in told[1:]:
            if line.startswith('#'):
                continue
            row = dict(zip(names, map(float, re.split(r'[\s,;]+', line)), strict=True))
            place, turn = (np.array([row[k] for k in some]) for some in ('XYZ', _TURN))
            yield number, MM * place, *_pointing(turn), row.get('FEED', 6e4 * feed) * MM / 60.0
        return
    values = list[float]()
    for number, line in told:
        if found := re.fullmatch(r'[XYZW]: *(\S+)', line):
            values.append(float(found[1]))
        if len(values) == 7:
            yield number, np.array(values[:3]), *_pointing(np.array(values[3:])), feed
            values.clear()
    if values:
        raise refuse(told[-1][1])


_TURN = ('QX', 'QY', 'QZ', 'QW')


def _pointing(turn: FloatArray) -> tuple[FloatArray, float]:
    """Return the tool axis and the spin [rad] of a quaternion x y z w.

    The quaternion is a product: the least turn that leads part Z to the tool axis, times the spin
    about part Z, times a half turn about X, after which Z of the TCP is the tool axis.
    """
    x, y, z, w = turn / np.linalg.norm(turn)
    # Times the inverse half turn about X: (x, y, z, w) becomes (w, z, -y, -x), up to its sign.
    x, y, z, w = w, z, -y, -x
    axis = np.array([2 * (x * z + w * y), 2 * (y * z - w * x), w * w + z * z - x * x - y * y])
    return axis, float(2.0 * np.arctan2(z, w))
