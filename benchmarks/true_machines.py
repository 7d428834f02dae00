"""Random machines with geometric errors: their true positions, and what a measurement gives.

A true machine is a chain of frames from the workpiece over the bed to the tool. Every carriage has
errors about its own point, with finite rotations. Its machine file has what instruments measure:
the position of the tip over the workpiece while one axis moves alone. This script shares nothing
with the map of ``error_map.py``.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from cnc_interp import Blocks
from cnc_interp.core.small_files import read_yaml
from cnc_interp.machine_model.machine import find_machine_file, from_mapping
from cnc_interp.machine_model.transform_port import Transform

Floats = NDArray[np.float64]
BASES = 'xyzac', 'vmc', 'head_table', 'head_head', 'xyzacw', 'bc_trunnion', 'router'
NODES = 41  #: Of each table.
#: Displacements [m] and rotations [rad] over the travel; wave lengths, in travels.
SIZES, WAVES = np.repeat([15e-6, 30e-6], 3), np.array([1.0, 0.5, 0.33, 0.2])


class TrueMachine:
    """Machine number ``seed``: ``machine`` compensates, ``ideal`` has no errors."""

    def __init__(self, seed: int):
        rng = np.random.default_rng(seed)
        self.content: dict[str, Any] = read_yaml(find_machine_file(BASES[seed % len(BASES)]))
        content = self.content
        if 'rotary' in content:
            _misplace(rng, content['rotary'])
        self.ideal = from_mapping(content)
        self.travel = self.ideal.travel[:3]
        self.order = rng.permutation(3)  # X Y Z from the workpiece to the tool
        self.bed = int(rng.integers(0, 4))  # so many of them carry the workpiece
        middle, half = self.travel.mean(axis=1), 0.5 * np.ptp(self.travel, axis=1)
        self.measured_at = middle + half * rng.uniform(-0.8, 0.8, 3)
        self.places = rng.uniform(-0.3, 0.3, (3, 3))
        self.waves = rng.uniform(-1.0, 1.0, (3, len(WAVES), 6)) * WAVES[:, None] * SIZES
        self.phases = rng.uniform(0.0, 2.0 * np.pi, (3, len(WAVES), 6))
        self.slopes = rng.uniform(-1.0, 1.0, (3, 6)) * SIZES / half[:, None]
        self.length = float(rng.choice([0.0, rng.uniform(0.05, 0.2)]))
        square = dict(zip(('C0Y', 'B0Z', 'A0Z'), rng.uniform(-60.0, 60.0, 3), strict=True))
        self.slopes[1, 0] -= 1e-6 * square['C0Y']
        self.slopes[2, :2] += 1e-6 * np.array([square['B0Z'], -square['A0Z']])
        content['errors'] = {
            'chain': ''.join('XYZ'[a] for a in self.order),
            'squareness': {f'{name}_urad': float(angle) for name, angle in square.items()},
            'tool_length_mm': 1e3 * self.length,
            'measured_at_mm': {a: (1e3 * self.measured_at).tolist() for a in 'XYZ'},
            **{axis: self._survey(a, square) for a, axis in enumerate('XYZ')},
        }
        self.machine = from_mapping(content)

    def _errors(self, a: int, x: Floats) -> Floats:
        """Errors of a carriage at positions of its axis, (n, 6); zero where it was measured."""
        low, high = self.travel[a]

        def waves(x: Floats) -> Floats:
            angle = 2.0 * np.pi * (x[:, None, None] - low) / ((high - low) * WAVES[:, None])
            return (self.waves[a] * np.sin(angle + self.phases[a])).sum(axis=1)

        zero = self.measured_at[a : a + 1]
        return waves(x) - waves(zero) + (x - zero)[:, None] * self.slopes[a]

    def _carried(self, c: Floats, true: bool) -> Floats:
        """Frames of the tool over the workpiece's table, (n, 4, 4)."""
        sides = []
        for axes, sign in ((self.order[: self.bed][::-1], -1.0), (self.order[self.bed :], 1.0)):
            frame = np.broadcast_to(np.eye(4), (len(c), 4, 4))
            for a in axes:
                frame = frame @ _shift(sign * np.eye(3)[a] * c[:, a, None])
                errors = self._errors(a, c[:, a]) * true
                turn = _shift(errors[:, :3])
                turn[:, :3, :3] = Rotation.from_rotvec(errors[:, 3:]).as_matrix()
                frame = frame @ _shift(self.places[a]) @ turn @ _shift(-self.places[a])
            sides.append(frame)
        return np.linalg.inv(sides[0]) @ sides[1]

    def _survey(self, a: int, square: dict[str, float]) -> dict[str, list[float]]:
        at = np.linspace(*self.travel[a], NODES)
        c = np.tile(self.measured_at, (NODES, 1))
        c[:, a] = at
        frame = self._carried(c, True)
        way = 1e6 * (frame[:, :3, 3] - c)
        turn = 1e6 * Rotation.from_matrix(frame[:, :3, :3]).as_rotvec()
        if a == 1:
            way[:, 0] += square['C0Y'] * at
        elif a == 2:
            way[:, :2] -= np.outer(at, [square['B0Z'], -square['A0Z']])
        axis, columns = 'XYZ'[a], {'at_mm': (1e3 * at).tolist()}
        for k in range(3):
            columns[f'E{"XYZ"[k]}{axis}_um'] = way[:, k].tolist()
            columns[f'E{"ABC"[k]}{axis}_urad'] = turn[:, k].tolist()
        return columns

    def tips(self, c: Floats, true: bool = True) -> Floats:
        """Where the tip is over the workpiece, (n, 3) [m], at commanded axes."""
        machine, n = self.ideal, len(c)
        turn = [
            Rotation.from_rotvec(u * c[:, 3 + k, None]) if machine.has_rotary else None
            for k, u in enumerate(machine.rotary_direction)
        ]
        low, high = machine.tool_offset
        arm = np.tile(low + [0.0, 0.0, self.length], (n, 1))
        tool = (low + high) * any(machine.rotary_on_head)
        if machine.rotary_on_head[1]:
            arm = turn[1].apply(arm)
        arm = arm + high
        if machine.rotary_on_head[0]:
            arm = turn[0].apply(arm)
        own = 5 if machine.has_rotary else 3
        tool = tool - arm + c[:, own:] @ machine.extra_direction
        frame = self._carried(c, true)
        p = (frame[:, :3, :3] @ tool[:, :, None])[:, :, 0] + frame[:, :3, 3] - machine.offsets[2]
        if turn[0] is not None and not machine.rotary_on_head[0]:
            p = turn[0].apply(p, inverse=True)
        p = p - machine.offsets[1]
        if turn[1] is not None and not machine.rotary_on_head[1]:
            p = turn[1].apply(p, inverse=True)
        return np.asarray(p - machine.offsets[0])

    def places_of_axes(self, rng: np.random.Generator, count: int, part: float) -> Floats:
        """Random axis positions within a part of the travel, (count, n_axes)."""
        low, high = np.clip(self.ideal.travel, -1.0, 1.0).T
        half = 0.5 * part * (high - low)
        return 0.5 * (low + high) + half * rng.uniform(-1.0, 1.0, (count, len(low)))

    def blocks(self, rng: np.random.Generator, count: int = 8) -> Blocks:
        """A short program of straight lines between poses that the machine reaches."""
        q = self.places_of_axes(rng, count, 0.4)
        tip, axis = Transform.of(self.ideal).forward(q)
        beside = q[:, 5 if self.ideal.has_rotary else 3 :]
        return replace(Blocks.of_poses(tip, axis, 0.1), extra=beside)


def _misplace(rng: np.random.Generator, rotary: dict[str, Any]) -> None:
    """Move and tilt the rotary axes: as ``probe-rotary`` finds them, the file has their places."""
    for key in list(rotary):
        if key.endswith('_mm') and 'workpiece' not in key:
            rotary[key] = (np.array(rotary[key]) + rng.uniform(-0.05, 0.05, 3)).tolist()
    for key in ('primary', 'secondary'):
        about = np.array(rotary[key]['about'], dtype=float)
        rotary[key]['about'] = (about + rng.uniform(-5e-5, 5e-5, 3)).tolist()


def _shift(way: Floats) -> Floats:
    found = np.broadcast_to(np.eye(4), (*np.shape(way)[:-1], 4, 4)).copy()
    found[..., :3, 3] = way
    return found
