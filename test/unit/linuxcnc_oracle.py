"""
Blocks against LinuxCNC's own interpreter (``rs274``): ends, arcs, feeds, rotary words, offsets.

``rs274`` prints what it would tell a machine to do, with four decimals of the program's unit, in
coordinates less the offsets that it prints too. Both readers start from the same text; nothing is
shared.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from cnc_interp.kinematics.machine import Machine
from cnc_interp.kinematics.transform import Transform
from cnc_interp.program import JobSetup, read_program
from cnc_interp.settings.choices import Settings

#: One unit of the last decimal printed.
LAST_DIGIT = 1e-4
#: Public programs that LinuxCNC reads: the machine for their words, and whether only to a part.
PROGRAMS = {
    'camotics-heart': ('xyz', False),
    'cnclite-blend-mpf': ('xyz', False),
    'fanuc-test-g91': ('xyz', False),
    'linuxcnc-cds': ('xyz', False),
    'linuxcnc-impeller-xyzac': ('xyzac', False),
    'linuxcnc-stellabee': ('xyz', False),
    'mach-pulley-r-arcs': ('xyz', False),
    'nist-box-op5': ('xyz', True),
    'opencn-congee-5x': ('xyzbc', False),
    'pycam-sample': ('xyz', False),
    'qtpyvcp-bezel': ('xyz', False),
    'solidcam-4x-rotx': ('xyza', False),
    'ugs-gates': ('xyz', False),
}
_CALL = re.compile(r'^\s*\d+\s+\S+\s+(\w+)\((.*)\)\s*$')
_PLANES = {'XY': (0, 1, 2), 'XZ': (2, 0, 1), 'YZ': (1, 2, 0)}


@dataclass
class Motion:
    """One motion of LinuxCNC in mm and deg; ``centre`` in the plane (a, b) for arcs."""

    rapid: bool
    end: np.ndarray
    rotary: np.ndarray
    feed: float
    plane: tuple[int, int, int] = (0, 1, 2)
    centre: tuple[float, float] = (0.0, 0.0)
    turns: int = 0
    decimals: float = LAST_DIGIT


@dataclass
class Agreement:
    """How far the blocks are from LinuxCNC's motions; ``faults`` say where they differ."""

    motions: int
    arcs: int
    largest_gap: float
    faults: list[str]

    def __str__(self):
        if self.faults:
            return f'differs: {self.faults[0]}'
        return f'{self.motions:,} motions, {self.arcs:,} arcs agree'


def interpreter():
    """Return how to call rs274, None where it is not at hand."""
    found = os.environ.get('RS274') or shutil.which('rs274')
    return found if found and Path(found).exists() else None


#: Words of other controls that LinuxCNC refuses and that move nothing: TCP switches, D and H
#: beside a tool change, a dwell by F, rigid tapping.
_LEFT_OUT = re.compile(rb'[Mm]42[89]\b|(?<=M6 )D\d+ H\d+|^D\d+\r?$|G04F\d+|M29S\d+', re.MULTILINE)


def run_linuxcnc(program, tools=None):
    """
    Interpret a program with LinuxCNC.

    Returns
    -------
    list of Motion, str
        And what it complained about, empty when it read to the end.

    """
    with tempfile.TemporaryDirectory() as folder:
        table, part = Path(folder) / 'tool.tbl', Path(folder) / 'part.ngc'
        lengths = dict.fromkeys(range(1, 100), 0.0) | (tools or {})
        table.write_text(
            ''.join(f'T{n} P{n} Z{length / 25.4:.9f}\n' for n, length in lengths.items())
        )
        part.write_bytes(_LEFT_OUT.sub(b'', Path(program).read_bytes()))
        (Path(folder) / 'p.var').touch()
        command = [interpreter(), '-t', str(table), '-v', str(Path(folder) / 'p.var'), '-g']
        done = subprocess.run(
            [*command, str(part)], capture_output=True, text=True, errors='replace', check=False
        )
    said = [line for line in done.stderr.splitlines() if line != 'executing']
    complaint = ' '.join(said)
    if 'ended with no percent sign' in complaint:
        complaint = ''
    return motions_of(done.stdout), complaint


def motions_of(printed):
    """Turn the printed calls into motions in machine coordinates."""
    unit, plane, feed, inverse = 1.0, _PLANES['XY'], np.nan, False
    offsets = {name: np.zeros(6) for name in ('G5X', 'G92', 'TOOL')}
    here, found = np.zeros(6), []
    for line in printed.splitlines():
        match = _CALL.match(line)
        if match is None:
            continue
        name, text = match.groups()
        numbers = [float(word) for word in re.findall(r'-?\d+\.?\d*', text)]
        size = np.array([unit] * 3 + [1.0] * 3)
        if name == 'USE_LENGTH_UNITS':
            unit = 25.4 if 'INCHES' in text else 1.0
        elif name == 'SELECT_PLANE':
            plane = _PLANES[text[-2:]]
        elif name == 'SET_FEED_RATE':
            feed = numbers[0] * unit
        elif name == 'SET_FEED_MODE':
            inverse = numbers[-1] != 0.0
        elif name == 'COMMENT' and 'feed mode set to' in text:
            inverse = 'inverse' in text
        elif name == 'SET_G5X_OFFSET':
            offsets['G5X'] = np.array(numbers[1:7]) * size
        elif name == 'SET_G92_OFFSET':
            offsets['G92'] = np.array(numbers[:6]) * size
        elif name == 'USE_TOOL_LENGTH_OFFSET':
            offsets['TOOL'] = np.array(numbers[:6]) * size
        elif name in ('STRAIGHT_TRAVERSE', 'STRAIGHT_FEED'):
            here = np.array(numbers[:6]) * size + sum(offsets.values())
            shown = np.nan if inverse else feed
            rapid = name == 'STRAIGHT_TRAVERSE'
            found.append(Motion(rapid, here[:3], here[3:], shown, decimals=LAST_DIGIT * unit))
        elif name == 'ARC_FEED':
            a, b, normal = plane
            if plane == _PLANES['XZ']:  # printed as Z, X
                a, b = plane[0], plane[1]
            here = here.copy()
            total = sum(offsets.values())
            here[[a, b, normal]] = np.array([numbers[0], numbers[1], numbers[5]]) * unit
            here[:3] += total[:3]
            here[3:] = np.array(numbers[6:9]) + total[3:]
            centre = (numbers[2] * unit + total[a], numbers[3] * unit + total[b])
            found.append(
                Motion(False, here[:3], here[3:], np.nan if inverse else feed, plane, centre,
                       int(numbers[4]), LAST_DIGIT * unit)
            )  # fmt: skip
    return found


def compare(blocks, motions, points=None, rotary_columns=(), partly=False):
    """
    Follow LinuxCNC's motions through the blocks.

    Parameters
    ----------
    blocks : Blocks
        Ours.
    motions : list of Motion
        LinuxCNC's.
    points : ndarray, shape (n, 3), optional
        X Y Z of the blocks in machine coordinates [m], where they are not the tool tips.
    rotary_columns : sequence of int
        Which of A, B, C the two rotary columns of the blocks are.
    partly : bool
        True if LinuxCNC stopped before the end.

    """
    points = (blocks.tip if points is None else points) * 1e3
    result = Agreement(0, 0, 0.0, [])
    row, before = 0, None
    for motion in _from_start(points[0], motions):
        still = before is not None and not motion.turns and np.array_equal(motion.end, before.end)
        if before is None or (still and np.array_equal(motion.rotary, before.rotary)):
            before = before or motion
            continue
        if row + 1 >= len(points):
            result.faults.append(f'our blocks end before {motion}')
            return result
        line = blocks.line_number[row + 1]
        if motion.turns:
            row = _follow_arc(points, row, before, motion, result, line)
            result.arcs += 1
        else:
            row = _follow_line(blocks, points, row, motion, rotary_columns)
        gap = _gap(points[row], motion.end)
        result.largest_gap = max(result.largest_gap, gap)
        if gap > 2 * motion.decimals:
            result.faults.append(
                f'line {line}: at {points[row].round(4)}, LinuxCNC at {motion.end.round(4)}'
            )
            return result
        _compare_words(blocks, row, motion, rotary_columns, result)
        result.motions += 1
        before = motion
    if row != len(points) - 1 and not partly:
        result.faults.append(f'we move on at line {blocks.line_number[row + 1]}')
    return result


def _compare_words(blocks, row, motion, rotary_columns, result):
    """Compare rapid, F and rotary words."""
    line = blocks.line_number[row]
    if blocks.rapid[row] != motion.rapid:
        result.faults.append(f'line {line}: rapid {blocks.rapid[row]}, LinuxCNC {motion.rapid}')
    elif not motion.rapid and np.isfinite(motion.feed) and np.isfinite(blocks.feedrate[row]):
        ours = blocks.feedrate[row] * 6e4
        if abs(ours - motion.feed) > motion.decimals + 1e-9 * ours:
            result.faults.append(f'line {line}: F {ours:.4f}, LinuxCNC {motion.feed:.4f}')
    for k, column in enumerate(rotary_columns):
        ours = np.degrees(blocks.rotary[row, k])
        if np.isfinite(ours) and abs(ours - motion.rotary[column]) > 2e-4:
            result.faults.append(
                f'line {line}: {"ABC"[column]}{ours:.4f}, LinuxCNC {motion.rotary[column]:.4f}'
            )


def _follow_line(blocks, points, row, motion, rotary_columns):
    """Walk along the pieces of a block until LinuxCNC's end is reached."""
    line = blocks.line_number[row + 1]
    wanted = [motion.rotary[column] for column in rotary_columns]
    while True:
        row += 1
        angles = np.degrees(blocks.rotary[row])[: len(wanted)]
        there = not np.any(np.abs(angles - wanted) > 2e-4)
        if there and _gap(points[row], motion.end) < motion.decimals:
            return row
        if row + 1 == len(points) or blocks.line_number[row + 1] != line:
            return row


def _gap(point, other):
    return float(np.abs(point - other).max())


def _from_start(start, motions):
    """Our first block is the start pose: begin with LinuxCNC's first motion that ends there."""
    for i, motion in enumerate(motions):
        if _gap(motion.end, start) < 2 * motion.decimals:
            return motions[i:]
    return []


def _follow_arc(points, row, before, motion, result, line):
    """Walk along chords until LinuxCNC's arc has been run through; all lie on its circle."""
    a, b, _ = motion.plane
    centre = np.array(motion.centre)

    def polar(point):
        v = point[[a, b]] - centre
        return np.hypot(*v), np.arctan2(v[1], v[0])

    radius, angle = polar(before.end)
    end_radius, end_angle = polar(motion.end)
    sign = np.sign(motion.turns)
    sweep = (sign * (end_angle - angle)) % (2 * np.pi)
    if np.array_equal(before.end[[a, b]], motion.end[[a, b]]):
        sweep = 2 * np.pi
    sweep += 2 * np.pi * (abs(motion.turns) - 1)
    # Angles are known as well as the printed digits: as much as that may be left over.
    unsure = 4 * motion.decimals / max(radius, motion.decimals)
    run, last = 0.0, angle
    first = row + 1
    while (row < first or run < sweep - unsure) and row + 1 < len(points):
        row += 1
        now_radius, now = polar(points[row])
        step = sign * (now - last)
        run += (step + np.pi) % (2 * np.pi) - np.pi
        last = now
        off = max(now_radius - max(radius, end_radius), min(radius, end_radius) - now_radius)
        if off > 3 * motion.decimals:
            result.faults.append(f'line {line}: {off:.4g} mm off the circle')
            break
    if abs(run - sweep) > 2 * unsure:
        result.faults.append(f'line {line}: an arc of {run:.4f} rad, LinuxCNC {sweep:.4f}')
    return row


def judged(path, machine_name, partly, tools=None):
    """Compare a file; machine coordinates are LinuxCNC's: zero at the workpiece zero."""
    machine = Machine.load(machine_name)
    machine = replace(machine, offsets=np.zeros((3, 3)))
    geometry = Transform.of(machine)
    at_zero = {f'G{number}': dict.fromkeys('XYZ', 0.0) for number in range(54, 60)}
    lengths = {number: length / 1e3 for number, length in (tools or {}).items()}
    setup = JobSetup(at_zero, lengths)
    blocks = read_program(path, geometry, Settings(feedrate=0.05), setup).blocks
    motions, complaint = run_linuxcnc(path, tools)
    assert partly or not complaint, complaint
    points, columns = None, []
    if machine.has_rotary:
        columns = ['ABC'.index(letter) for letter in machine.axis_names[3:]]
        if machine_name != 'xyzac' or tools is not None:  # there, words are tool tips
            points = geometry.linear(blocks.tip, np.nan_to_num(blocks.rotary))
    return compare(blocks, motions, points, columns, partly)
