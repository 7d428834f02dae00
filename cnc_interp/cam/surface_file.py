"""Surface files: STEP, or JSON in mm and degrees (docs/how_it_works/cam.md).

{"kind": "bumps", "size_mm": [40, 30], "bumps_mm": [[x, y, height, width], ...],
"placement": {"rotation_deg": [rx, ry, rz], "shift_mm": [x, y, z]}}
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from cnc_interp.cam.shapes import BSplineSurface, Bumps, Cap, Cylinder, Plane, Torus
from cnc_interp.cam.step_file import Part
from cnc_interp.cam.step_process import read_step_safely
from cnc_interp.cam.surface import Placed, Surface, SurfaceError
from cnc_interp.core.arrays import FloatArray
from cnc_interp.core.small_files import UnreadableError, read_json
from cnc_interp.core.units import DEG, MM

STEP_SUFFIXES = '.step', '.stp', '.p21'
#: Keys of each kind of surface, and whether they are optional.
KEYS: dict[str, dict[str, bool]] = {
    'plane': {'size_mm': False},
    'bumps': {'size_mm': False, 'bumps_mm': False},
    'cap': {'size_mm': False, 'radius_mm': False, 'blend_mm': False, 'angle_deg': False},
    'cylinder': {'radius_mm': False, 'angle_deg': False, 'length_mm': False, 'hollow': True},
    'sphere': {'radius_mm': False, 'u_angle_deg': False, 'v_angle_deg': False},
    'torus': {
        'ring_mm': False, 'radius_mm': False, 'u_angle_deg': False, 'v_angle_deg': False,
    },
    'bspline': {
        'knots_u': False, 'knots_v': False, 'points_mm': False, 'degree': True, 'flip': True,
    },
    'grid': {'points_mm': False, 'flip': True},
}  # fmt: skip


class _File:
    """The contents of one file, with its name for errors."""

    def __init__(self, path: Path, contents: Any):
        self.path, self.contents = path, contents

    def fault(self, message: str) -> SurfaceError:
        return SurfaceError(f'{self.path}: {message}')

    def numbers(self, key: str, shape: tuple[int, ...], default: Any = None) -> FloatArray:
        """Return an array of finite numbers; -1 in the shape stands for any length."""
        value = self.contents.get(key, default)
        try:
            array = np.asarray(value, float)
        except (TypeError, ValueError):
            array = np.full(1, np.nan)
        fits = array.ndim == len(shape) and all(
            a == b or b < 0 for a, b in zip(array.shape, shape, strict=True)
        )
        if not fits or not np.isfinite(array).all():
            size = ' x '.join('n' if n < 0 else str(n) for n in shape)
            raise self.fault(f'{key} must hold {size + " " if shape else "one "}finite numbers')
        return array

    def number(self, key: str, unit: float) -> float:
        return float(self.numbers(key, ())) * unit


def read_surface(
    path: Path, face: int | None = None, note: Callable[[str], None] | None = None
) -> Surface:
    """Read one surface; as ``read_part``."""
    (surface,) = read_part(path, [] if face is None else [face], note).surfaces.values()
    return surface


def read_part(
    path: Path, faces: Sequence[int] = (), note: Callable[[str], None] | None = None
) -> Part:
    """Read a surface file, or faces of a STEP file (.step, .stp, .p21)."""
    if path.suffix.lower() in STEP_SUFFIXES:
        return read_step_safely(path, faces, note)
    if faces:
        raise SurfaceError(f'{path}: --face is for STEP files ({", ".join(STEP_SUFFIXES)})')
    try:
        contents = read_json(path)
    except OSError as error:
        raise SurfaceError(f'{path}: cannot be opened: {error.strerror}') from error
    except UnreadableError as error:
        raise SurfaceError(f'{path}: cannot be read: {error}') from None
    file = _File(path, contents)
    kind = contents.get('kind') if isinstance(contents, dict) else None
    if not isinstance(kind, str) or kind not in KEYS:
        raise file.fault(f'kind is {kind!r}; it must be one of {", ".join(KEYS)}')
    known = {'kind', 'placement', 'comment', *KEYS[kind]}
    for key in contents:
        if key not in known:
            raise file.fault(f'{key} has no meaning for {kind}; it has {", ".join(KEYS[kind])}')
    for key, optional in KEYS[kind].items():
        if not optional and key not in contents:
            raise file.fault(f'{key} is missing')
    try:
        surface = _surface(file, kind)
    except SurfaceError as error:
        raise error if str(error).startswith(str(path)) else file.fault(str(error)) from error
    return Part({1: _placed(file, surface)})


def _surface(file: _File, kind: str) -> Surface:
    if kind in ('plane', 'bumps', 'cap'):
        x, y = (file.numbers('size_mm', (2,)) * MM).tolist()
        if kind == 'plane':
            return Plane((x, y))
        if kind == 'bumps':
            return Bumps((x, y), file.numbers('bumps_mm', (-1, 4)) * MM)
        return Cap(
            (x, y), file.number('radius_mm', MM), file.number('blend_mm', MM),
            file.number('angle_deg', DEG),
        )  # fmt: skip
    if kind == 'cylinder':
        hollow = bool(file.contents.get('hollow', False))
        return Cylinder(
            file.number('radius_mm', MM), file.number('angle_deg', DEG),
            file.number('length_mm', MM), hollow,
        )  # fmt: skip
    if kind in ('sphere', 'torus'):
        ring = file.number('ring_mm', MM) if kind == 'torus' else 0.0
        return Torus(
            ring, file.number('radius_mm', MM), file.number('u_angle_deg', DEG),
            file.number('v_angle_deg', DEG),
        )  # fmt: skip
    flip = bool(file.contents.get('flip', False))
    points = file.numbers('points_mm', (-1, -1, 3)) * MM
    if kind == 'grid':
        return BSplineSurface.through(points, flip)
    degree = file.numbers('degree', (2,), [3, 3]).astype(int)
    knots = file.numbers('knots_u', (-1,)), file.numbers('knots_v', (-1,))
    return BSplineSurface(knots, points, (int(degree[0]), int(degree[1])), flip)


def _placed(file: _File, surface: Surface) -> Surface:
    placement = file.contents.get('placement')
    if placement is None:
        return surface
    if not isinstance(placement, dict) or set(placement) - {'rotation_deg', 'shift_mm'}:
        raise file.fault('placement has rotation_deg and shift_mm, three numbers each')
    inner = _File(file.path, placement)
    turn = inner.numbers('rotation_deg', (3,), [0.0, 0.0, 0.0])
    shift = inner.numbers('shift_mm', (3,), [0.0, 0.0, 0.0]) * MM
    rotation = Rotation.from_euler('xyz', turn, degrees=True).as_matrix()
    return Placed(surface, np.asarray(rotation), shift)
