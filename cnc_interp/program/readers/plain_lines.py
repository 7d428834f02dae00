"""Convert many plain lines to targets at once, with the same result as ``block_motion.py``."""

from math import inf, nan, pi

import numpy as np
from numpy.typing import NDArray

from cnc_interp.core import DEG, MINUTE, FloatArray, IntArray
from cnc_interp.program.execution.context import Execution
from cnc_interp.program.geometry import target_row as col
from cnc_interp.program.geometry.arcs import PLANES, TOLD, arcs_of
from cnc_interp.program.modal.state import FARTHEST, LONG_WAY, SLOWEST
from cnc_interp.program.motion.block_motion import MOST_TURN, Mover
from cnc_interp.program.text import scan
from cnc_interp.program.text.control_traits import PLAIN

_LINEAR, _ROTARY_WORDS, _ARC_WORDS = slice(0, 3), slice(3, 6), slice(6, 10)
SHORTEST = 6  #: Least number of lines for which this is faster than line by line.


def _filled(values: FloatArray, first: float) -> FloatArray:
    given = np.isfinite(values)
    last = np.maximum.accumulate(np.where(given, np.arange(len(values)), -1))
    return np.where(last >= 0, values[last], first)


def move_along(at: Execution, code: NDArray[np.int8], values: FloatArray, lines: IntArray) -> bool:
    """Execute plain lines; return False, and change nothing, if the general reader is needed."""
    mover = at.mover
    if (
        at.cycle is not None
        or at.called is not None
        or at.splines.open
        or at.plane.parts
        or at.settings.numbers == 'increments'
        or mover.radius_code
        or mover.by_surface_speed
        or mover.targets.empty
        or mover.stop_once
        or mover.vector is not None
        or mover.tcp == 'G43.5'
        or mover.feed_mode == 'G95'
        or mover.leaves_contour
        or mover.beside is not None
        or mover.shifted.any()
        or mover.polar
        or mover.held is not None
        or mover.corner.modal
        or mover.frames.scales
    ):
        return False
    motion = _filled(np.where(code >= 0, code, nan), nan if mover.motion is None else mover.motion)
    linear_words, arc_words = values[:, _LINEAR], np.isfinite(values[:, _ARC_WORDS]).any(axis=1)
    on_arc = motion >= 2.0
    rotary_words = np.isfinite(values[:, _ROTARY_WORDS])
    mover.targets.length = mover.frames.length if mover.tcp else 0.0
    tells = mover.by_axes and mover.dialect is PLAIN and not mover.told_feed_of_turns
    if (tells or mover.targets.length) and rotary_words.any():
        return False
    moves = np.isfinite(linear_words).any(axis=1) | rotary_words.any(axis=1) | (on_arc & arc_words)
    others = [i for i, letter in enumerate('ABC') if letter not in mover.rotary_letters]
    if np.isnan(motion[moves]).any() or (arc_words & ~on_arc).any():
        return False
    if rotary_words[:, others].any():
        return False
    feeds = _feeds(mover, values[:, scan.F], motion[moves] == 0.0, moves)
    if feeds is None:
        return False
    program = _program_positions(mover, values)
    points = mover.frames.point(program[:, :3])
    rotary = program[:, 3:] + mover.frames.rotary_origin
    if np.abs(points).max() > FARTHEST or np.nan_to_num(np.abs(rotary)).max() > MOST_TURN:
        return False
    rows = np.full((int(moves.sum()), col.WIDTH), nan)
    on_arc &= moves
    if on_arc.any() and not _arcs(mover, motion, on_arc, program, values, rows, moves):
        return False
    rapid = motion[moves] == 0.0
    rows[:, col.POINT], rows[:, col.ROTARY] = points[moves], rotary[moves]
    if not mover.rotary_letters:
        rows[:, col.AXIS] = (0.0, 0.0, 1.0)
    named = np.maximum.accumulate(rotary_words.any(axis=1)) | bool(mover.named)
    rows[:, col.NAMED] = named[moves]
    rows[:, col.GREAT_CIRCLE] = mover.on_great_circle
    rows[:, col.EXTRA] = mover.extra
    rows[:, col.FEEDRATE], rows[:, col.DURATION], rows[:, col.TURN_RATE] = feeds
    rows[:, col.RAPID], rows[:, col.EXACT_STOP] = rapid, mover.stop_always
    per_word = 1.0 if mover.feed_mode == 'G93' else mover.unit / MINUTE
    rows[:, col.FEED] = _filled(values[:, scan.F] * per_word, mover.feed_word)[moves]
    rows[:, col.MOTION] = motion[moves]
    rows[:, col.CONTOUR], rows[:, col.ORIENTATION] = mover.tolerances()
    rows[:, col.LINE], rows[:, col.AXES] = lines[moves], mover.axes_column
    if mover.rotary_letters and len(rows):
        turned = np.abs(np.diff(np.vstack([mover.rotary, rotary[moves]]), axis=0))
        cutting = turned.max(axis=1) * ~rapid
        if cutting.max() > LONG_WAY:
            return False  # a long way round: the general reader gives the notice
    if np.isfinite(motion[-1]):
        mover.motion = int(motion[-1])
    given = values[np.isfinite(values[:, scan.F]), scan.F]
    if len(given):
        mover.set_feed(float(given[-1]), 'F', mover.unit)
    mover.point, mover.rotary, mover.named = points[-1], rotary[-1], float(named[-1])
    mover.targets.extend(rows)
    return True


def _feeds(
    mover: Mover, words: FloatArray, rapid: NDArray[np.bool_], moves: NDArray[np.bool_]
) -> tuple[FloatArray, FloatArray, FloatArray] | None:
    """Return feedrate, duration and turn rate of the moving lines; None if one is missing."""
    given = np.isfinite(words)
    if (words[given] <= 0.0).any():
        return None
    if mover.feed_mode == 'G93':
        if (words[given] < SLOWEST).any():
            return None
        rate = _filled(words, mover.blocks_per_minute or nan)[moves]
        if (np.isnan(rate) & ~rapid).any() or (~given[moves] & ~rapid).any():
            return None
        duration = np.where(rapid, nan, MINUTE / rate)
        return np.where(rapid, inf, nan), duration, np.full(len(rate), inf)
    feed = _filled(words * mover.unit / MINUTE, mover.feedrate or nan)[moves]
    turn = _filled(words * DEG / MINUTE, mover.turn_rate)[moves]
    if (np.isnan(feed) & ~rapid).any():
        return None
    return np.where(rapid, inf, feed), np.full(len(feed), nan), np.where(rapid, inf, turn)


def _program_positions(mover: Mover, values: FloatArray) -> FloatArray:
    here = mover.here()
    program = np.empty((len(values), 5))
    program[:, 3:] = here[3:]
    columns = [0, 1, 2, *(scan.COLUMNS.index(letter) for letter in mover.rotary_letters)]
    for i, column in enumerate(columns):
        words = values[:, column] * (mover.unit if i < 3 else DEG)
        if not mover.incremental:
            program[:, i] = _filled(words, float(here[i]))
            if i >= 3 and mover.settings.rotary_sense == 'shortest':
                steps = np.diff(program[:, i], prepend=here[i])
                steps -= 2.0 * pi * np.round(steps / (2.0 * pi))
                program[:, i] = here[i] + np.cumsum(steps)
        else:
            # Add the words one after the other, in the same order as line by line.
            steps = np.where(np.isfinite(words), words, 0.0)
            program[:, i] = np.cumsum(np.concatenate([here[i : i + 1], steps]))[1:]
    return program


def _arcs(
    mover: Mover,
    motion: FloatArray,
    on_arc: NDArray[np.bool_],
    program: FloatArray,
    values: FloatArray,
    rows: FloatArray,
    moves: NDArray[np.bool_],
) -> bool:
    if mover.lone_arc is not None:
        return False
    before = np.vstack([mover.here(), program[:-1]])
    unit, sense = mover.unit, 1.0 if mover.centre_absolute else mover.centre_sense
    arcs = arcs_of(
        mover.plane,
        motion[on_arc] == 3.0,
        before[on_arc, :3],
        program[on_arc, :3],
        values[on_arc][:, scan.I : scan.K + 1] * (unit * sense),
        values[on_arc, scan.R] * unit,
        mover.centre_absolute,
        unit=unit,
    )
    if arcs.fault.any() or (arcs.mismatch > TOLD).any():
        return False
    mover.last_centre = values[on_arc][-1:, scan.I : scan.K + 1] * (unit * sense)
    mover.centres_open &= not np.isfinite(values[on_arc][:, scan.I : scan.K + 1]).any()
    mover.last_radius = float(values[on_arc, scan.R][-1] * unit)
    which = on_arc[moves]
    rows[which, col.CENTRE] = mover.frames.point(arcs.centre)
    rows[which, col.NORMAL] = mover.frames.turn[:, PLANES[mover.plane][2]]
    rows[which, col.SWEEP] = arcs.sweep
    return True
