"""The rows that the compressor sends: lines to vertices of the skeleton, and parts of curves."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cnc_interp.core.arrays import FloatArray
from cnc_interp.smoothing.dense.curve_fit import Window
from cnc_interp.smoothing.dense.end_lines import EndLine
from cnc_interp.smoothing.dense.path_rows import Rows
from cnc_interp.smoothing.dense.skeleton import Skeleton


def line_row(
    skeleton: Skeleton,
    k: int,
    leg: EndLine | None,
    leads: bool,
    off: FloatArray | None,
    smooth: bool,
) -> Rows:
    """Return the row of the line to vertex k."""
    block = replace(skeleton.blocks[k : k + 1], exact_stop=skeleton.stop[k : k + 1].copy())
    tolerance = skeleton.tolerance[k]
    if leg is not None:
        off, tolerance = leg.used, leg.tolerance
    elif off is None:
        off = skeleton.used[k]
    if leg is not None and not block.rapid[0]:
        block = replace(block, feedrate=np.array([leg.feed]))
    if leg is not None and leads:
        block = replace(
            block, tip=leg.pose[0][None].copy(), axis=leg.pose[1][None].copy(),
            rotary=np.full((1, 2), np.nan), exact_stop=np.zeros(1, dtype=bool),
        )  # fmt: skip
    block = replace(
        block,
        contour_tolerance=tolerance[:1] - off[0],
        orientation_tolerance=tolerance[1:] - off[1],
    )
    return Rows.line(block, int(skeleton.row[k]), off, smooth=smooth, leads=leads)


def curve_row(skeleton: Skeleton, k: int, found: Window, stop: bool, smooth: bool) -> Rows:
    """Return the row of the committed part of a curve."""
    spans = found.spans
    assert spans is not None
    block = replace(
        skeleton.blocks[k : k + 1],
        tip=spans.bottom[-1:, 5].copy(),
        axis=found.axis[None],
        rotary=np.full((1, 2), np.nan),
        line_number=spans.line_number[-1:].copy(),
        exact_stop=np.array([stop]),
    )
    return Rows.curve(block, spans, smooth)
