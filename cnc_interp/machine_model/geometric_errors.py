"""Geometric errors of X Y Z: splines through the tables of the section ``errors``.

The table of an axis has six errors of the tool relative to the workpiece while only this axis
moves: three displacements along X Y Z, three rotations about X Y Z (ISO 230-1). Each error is the
actual minus the commanded value.
"""

from __future__ import annotations

import csv
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from cnc_interp.core import MM, UM, FloatArray, MachineError
from cnc_interp.core.small_files import is_number
from cnc_interp.machine_model import machine_entries as entries
from cnc_interp.machine_model.demands import demand

AXES = 'XYZ'
PLACES = 'at_mm'  #: Key of the axis positions in a table.
#: Squareness error [urad] -> the displacement that it adds: displacement, axis whose position
#: multiplies it, and sign. B0Z turns the line of Z about Y.
SQUARENESS = {'C0Y_urad': (0, 1, -1.0), 'B0Z_urad': (0, 2, 1.0), 'A0Z_urad': (1, 2, -1.0)}
#: Larger errors [m, rad], and larger slopes of errors [per m], suggest a wrong unit.
LARGEST, STEEPEST = np.full(6, 2e-3), np.full(6, 5e-3)
DEGREE = 5  #: Degree of the splines; their fourth derivatives are continuous.
#: Share of the travel that may lie beyond each end of a table, and least number of nodes that
#: are added to the table there.
UNCOVERED, FEWEST = 0.1, 3
GOES_ON: Any = {'mode': 'reflect', 'reflect_type': 'odd'}
FARTHEST = 20.0  #: If an axis has no table, squareness errors apply up to this position [m].
MOST = 4096  #: Largest number of nodes of a table.
UNEVEN = 4.0  #: Largest ratio of node distances: a spline through less even nodes oscillates [-].


@dataclass(frozen=True)
class ErrorTable:
    """The errors of one axis at n nodes. The nodes cover more than its travel."""

    at: FloatArray  #: (n,): Positions of the axis [m].
    values: FloatArray  #: (n, 6): Displacements along X Y Z [m], rotations about them [rad].

    @property
    def spline(self) -> Any:
        """B-spline of all six errors through the nodes."""
        from scipy.interpolate import make_interp_spline  # loaded with errors only

        return make_interp_spline(self.at, self.values, DEGREE)

    @property
    def between(self) -> FloatArray:
        """Axis positions at closer distances than the nodes, (8 n,) [m]."""
        return np.linspace(self.at[0], self.at[-1], 8 * len(self.at))


@dataclass(frozen=True)
class GeometricErrors:
    tables: tuple[ErrorTable, ErrorTable, ErrorTable]  #: Tables of X, Y and Z.
    chain: tuple[int, ...]  #: Indices of X Y Z in the order from workpiece to tool.
    #: (3, 3): Tip position at the measurement of X, of Y and of Z [m].
    measured_at: FloatArray
    tool_length: float  #: Distance of the usual tip from the tip of the machine file [m].

    @cached_property
    def bounds(self) -> FloatArray:
        """(4,): Bounds of the total error of an axis, and of its three derivatives [m, per m]."""
        reach = np.linalg.norm([np.ptp(table.at) for table in self.tables])
        weight = np.repeat([1.0, reach], 3)
        sizes = [
            [np.abs(table.spline(table.between, order)).max(axis=0) for table in self.tables]
            for order in range(4)
        ]
        return np.asarray((np.array(sizes) * weight).reshape(4, -1, 3).max(axis=2).sum(axis=1))


def columns_of(axis: str) -> dict[str, float]:
    """Return the columns that the table of an axis may have: name -> unit in SI."""
    return {f'E{way}{axis}_um': UM for way in AXES} | {
        f'E{turn}{axis}_urad': 1e-6 for turn in 'ABC'
    }


def geometric_errors(
    content: dict[str, Any], travel: FloatArray, folder: Path
) -> GeometricErrors | None:
    """Read the section ``errors``; ``travel`` (3, 2): travel of X Y Z [m]."""
    known = (*AXES, 'squareness', 'chain', 'measured_at_mm', 'tool_length_mm')
    given = entries.section(content, 'errors', known)
    if not given:
        return None
    square = entries.section(given, 'squareness', SQUARENESS)
    slopes = np.zeros((3, 6))
    for key, (row, axis, sign) in SQUARENESS.items():
        angle = entries.numbers([square.get(key, 0.0)], 1, f'errors.squareness.{key}')[0]
        slopes[axis, row] = sign * angle * 1e-6
    places = entries.section(given, 'measured_at_mm', AXES)
    measured = [
        entries.numbers(places.get(a, [0, 0, 0]), 3, f'errors.measured_at_mm.{a}') for a in AXES
    ]
    length = entries.numbers([given.get('tool_length_mm', 0.0)], 1, 'errors.tool_length_mm')[0]
    x, y, z = (
        error_table(given.get(a), a, travel[i], slopes[i], folder) for i, a in enumerate(AXES)
    )
    turns = any(table.values[:, 3:].any() for table in (x, y, z))
    chain = given.get('chain', '' if turns else AXES)
    demand(
        isinstance(chain, str) and sorted(chain) == sorted(AXES),
        'must be the linear axes in order from the workpiece to the tool, such as XYZ',
        'errors.chain',
    )
    order = tuple(AXES.index(a) for a in chain)
    return GeometricErrors((x, y, z), order, np.array(measured) * MM, length * MM)


def error_table(
    given: Any, axis: str, travel: FloatArray, slopes: FloatArray, folder: Path
) -> ErrorTable:
    """Read the table of an axis; ``slopes`` (6,) [per m] times its position are added."""
    where, units = f'errors.{axis}', columns_of(axis)
    if given is None:
        travel = np.clip(travel, -FARTHEST, FARTHEST)
        given = {PLACES: (travel / MM).tolist()}
    demand(np.isfinite(travel).all(), 'the axis is endless; give it travel_mm under limits', where)
    given = table_of(given, axis, folder)
    demand(
        isinstance(given, dict) and isinstance(given.get(PLACES), list),
        f'must be the name of a CSV file, or {PLACES} and lists of errors there',
        where,
    )
    entries.require_known(given, (PLACES, *units), where)
    count = len(given[PLACES])
    at = np.array(entries.numbers(given[PLACES], count, f'{where}.{PLACES}')) * MM
    demand(
        2 <= count <= MOST and (np.diff(at) > 0.0).all(),
        f'must be increasing positions, 2 to {MOST}',
        f'{where}.{PLACES}',
    )
    ways = np.diff(at)
    demand(
        (np.maximum(ways[1:], ways[:-1]) <= UNEVEN * np.minimum(ways[1:], ways[:-1])).all(),
        f'distances of neighbouring positions differ by more than a factor of {UNEVEN:g}',
        f'{where}.{PLACES}',
    )
    values = np.zeros((count, 6))
    for k, (key, unit) in enumerate(units.items()):
        if key in given:
            values[:, k] = np.array(entries.numbers(given[key], count, f'{where}.{key}')) * unit
    gaps = np.array([at[0] - travel[0], travel[1] - at[-1]])
    demand(
        (gaps <= UNCOVERED * np.ptp(travel)).all(),
        f'does not cover the travel {travel[0] / MM:g} ... {travel[1] / MM:g}',
        f'{where}.{PLACES}',
    )
    more = np.maximum(np.ceil(gaps / ways[[0, -1]]).astype(int), 0) + FEWEST
    at, values = (
        np.pad(rows, (more, *[(0, 0)] * (rows.ndim - 1)), **GOES_ON) for rows in (at, values)
    )
    found = ErrorTable(at, values + at[:, None] * slopes)
    for size, most in ((values, LARGEST), (found.spline(found.between, 1), STEEPEST)):
        row, k = divmod(int(np.argmax(np.abs(size) / most)), size.shape[1])
        demand(
            abs(size[row, k]) <= most[k],
            f'is too large or too steep for an error ({size[row, k] / 1e-6:.4g} um, urad, or per '
            'metre); is the unit right?',
            f'{where}.{list(units)[k]}',
        )
    return found


def table_of(given: Any, axis: str, folder: Path) -> Any:
    """Return the columns of a table; the entry holds them or names a CSV file."""
    if axis not in AXES or not isinstance(given, str):
        return given
    file, where = folder / given, f'errors.{axis}'
    try:
        with file.open(newline='', encoding='utf-8-sig') as rows:
            lines = [row for row in csv.reader(rows) if row and not row[0].startswith('#')]
    except (OSError, UnicodeDecodeError, csv.Error) as problem:
        raise MachineError(f'{file} cannot be read: {problem}', where) from None
    demand(len(lines) > 1, f'{file} has no rows below the names of its columns', where)
    names = [name.strip() for name in lines[0]]
    table: dict[str, list[float]] = {name: [] for name in names}
    for number, row in enumerate(lines[1:], start=2):
        demand(
            len(row) == len(names), f'{file}: row {number} has another number of columns', where
        )
        for name, text in zip(names, row, strict=True):
            try:
                table[name].append(float(text))
            except ValueError:
                raise MachineError(f'{file}: row {number}: {text!r} is no number', where) from None
    demand(
        all(is_number(x) for column in table.values() for x in column),
        f'{file}: not finite',
        where,
    )
    return table
