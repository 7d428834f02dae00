"""JobSetup: settings of the operator for a job: work offsets, tools, reference points."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from math import isfinite
from pathlib import Path
from typing import Any

from cnc_interp.core.errors import ProgramError
from cnc_interp.core.small_files import UnreadableError, read_yaml
from cnc_interp.core.units import DEG, MM

LETTERS = 'XYZABC'
WORK_OFFSETS = ('G54', 'G55', 'G56', 'G57', 'G58', 'G59', 'G59.1', 'G59.2', 'G59.3')
REFERENCE_POINTS = ('G28', 'G30')
Position = Mapping[str, float]


@dataclass(frozen=True)
class JobSetup:
    """
    The settings of the operator for one job.

    Parameters
    ----------
    work_offsets : mapping of str to position
        Machine coordinates of the workpiece zeros G54 to G59.3, by axis letter [m, rad]. If a zero
        is missing, the machine file gives the workpiece zero.
    tool_lengths : mapping of int to float
        Tool lengths by tool number [m].
    reference_points : mapping of str to position
        Machine coordinates of G28 and G30 by axis letter [m, rad]; missing values are 0.

    """

    work_offsets: Mapping[str, Position] = field(default_factory=dict)
    tool_lengths: Mapping[int, float] = field(default_factory=dict)
    reference_points: Mapping[str, Position] = field(default_factory=dict)

    @staticmethod
    def load(path: Path) -> JobSetup:
        """
        Read a setup from a YAML file in mm and deg.

        Parameters
        ----------
        path : Path
            The setup file.

        Returns
        -------
        JobSetup
            The settings in SI units.

        Raises
        ------
        ProgramError
            If the file is missing or not YAML, or a key or value is wrong.

        """
        try:
            content = read_yaml(path)
        except OSError as problem:
            raise ProgramError(f'cannot be opened: {problem.strerror}', str(path)) from None
        except UnreadableError as problem:
            raise ProgramError(f'cannot be read as YAML: {problem}', str(path)) from None
        keys = ('work_offsets', 'tools', 'reference_points')
        whole = _mapping(content, 'the file', str(path))
        for key in whole:
            if key not in keys:
                raise ProgramError(f'{key}: unknown; known: {", ".join(keys)}', str(path))
        offsets, tools, references = (
            _mapping(whole.get(key) or {}, key, str(path)) for key in keys
        )
        return JobSetup(
            {k: _position(offsets, k, WORK_OFFSETS, str(path)) for k in offsets},
            {_tool(k, str(path)): _length(tools, k, str(path)) for k in tools},
            {k: _position(references, k, REFERENCE_POINTS, str(path)) for k in references},
        )


def _mapping(content: Any, what: str, source: str) -> dict[Any, Any]:
    """Return a mapping of keys to values; raise if the content is not one."""
    if not isinstance(content, dict):
        raise ProgramError(f'{what}: must be a mapping; give keys with values', source)
    return content


def _number(value: Any, key: str, source: str) -> float:
    """Return a finite number; raise if the value is not one."""
    if isinstance(value, bool) or not isinstance(value, int | float) or not isfinite(value):
        raise ProgramError(f'{key}: must be a number, not {value!r}', source)
    return float(value)


def _position(
    content: dict[Any, Any], name: Any, known: tuple[str, ...], source: str
) -> dict[str, float]:
    """Return one position by axis letters [m, rad], from mm and deg."""
    if name not in known:
        raise ProgramError(f'{name}: unknown; known: {", ".join(known)}', source)
    words = _mapping(content[name], str(name), source)
    for letter in words:
        if letter not in list(LETTERS):
            raise ProgramError(f'{name}.{letter}: unknown axis; known: X Y Z A B C', source)
    return {
        letter: _number(value, f'{name}.{letter}', source) * (MM if letter in 'XYZ' else DEG)
        for letter, value in words.items()
    }


def _tool(key: Any, source: str) -> int:
    """Return a tool number; raise if the key is not a whole number."""
    if isinstance(key, bool) or not isinstance(key, int):
        raise ProgramError(f'tools.{key}: the tool number must be a whole number', source)
    return key


def _length(tools: dict[Any, Any], key: Any, source: str) -> float:
    """Return a tool length [m], from mm."""
    words = _mapping(tools[key], f'tools.{key}', source)
    if set(words) != {'length'}:
        raise ProgramError(f'tools.{key}: must have one key, as {{length: 75.0}}', source)
    return _number(words['length'], f'tools.{key}.length', source) * MM
