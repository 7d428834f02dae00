"""Surface files: STEP, or JSON in mm and degrees (docs/how_it_works/cam.md).

OpenCASCADE may crash or never end on a malicious STEP file. Therefore it runs in a separate
process that writes the surface, or an error message, to its standard output.
"""

import os
import pickle
import resource
import signal
import subprocess
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from cnc_interp.cam.shapes import BSplineSurface, Bumps, Cap, Cylinder, Plane, Torus
from cnc_interp.cam.step_file import Part, read_step_part
from cnc_interp.cam.surface import Placed, Surface, SurfaceError
from cnc_interp.core import DEG, MM, FloatArray, demand, refuse_if
from cnc_interp.core.small_files import BoundedMemory, UnreadableError, read_json

STEP_SUFFIXES = '.step', '.stp', '.p21'
#: Keys of each kind of surface, and those that may be left out.
KEYS = {
    'plane': ('size_mm',),
    'bumps': ('size_mm', 'bumps_mm'),
    'cap': ('size_mm', 'radius_mm', 'blend_mm', 'angle_deg'),
    'cylinder': ('radius_mm', 'angle_deg', 'length_mm', 'hollow'),
    'sphere': ('radius_mm', 'u_angle_deg', 'v_angle_deg'),
    'torus': ('ring_mm', 'radius_mm', 'u_angle_deg', 'v_angle_deg'),
    'bspline': ('knots_u', 'knots_v', 'points_mm', 'degree', 'flip'),
    'grid': ('points_mm', 'flip'),
}
OPTIONAL = ('hollow', 'degree', 'flip')


class _File:
    def __init__(self, path: Path, contents: Any):
        self.path, self.contents = path, contents

    def fault(self, message: str) -> SurfaceError:
        return SurfaceError(f'{self.path}: {message}')

    def numbers(self, key: str, shape: tuple[int, ...], default: Any = None) -> FloatArray:
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

    def number(self, key: str) -> float:
        return float(self.numbers(key, ())) * (MM if key.endswith('_mm') else DEG)


def read_part(
    path: Path, faces: Sequence[int] = (), note: Callable[[str], None] = lambda _: None
) -> Part:
    if path.suffix.lower() in STEP_SUFFIXES:
        return read_step_safely(path, faces, note)
    refuse_if(
        faces, SurfaceError(f'{path}: --face is for STEP files ({", ".join(STEP_SUFFIXES)})')
    )
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
        demand(
            key in known,
            file.fault(f'{kind} has no key {key}; its keys are {", ".join(KEYS[kind])}'),
        )
    for key in KEYS[kind]:
        refuse_if(key not in contents and key not in OPTIONAL, file.fault(f'{key} is missing'))
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
        return Cap((x, y), *map(file.number, ('radius_mm', 'blend_mm', 'angle_deg')))
    if kind == 'cylinder':
        radius, angle, length = map(file.number, ('radius_mm', 'angle_deg', 'length_mm'))
        return Cylinder(radius, angle, length, bool(file.contents.get('hollow', False)))
    if kind in ('sphere', 'torus'):
        ring = file.number('ring_mm') if kind == 'torus' else 0.0
        return Torus(ring, *map(file.number, ('radius_mm', 'u_angle_deg', 'v_angle_deg')))
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
        raise file.fault('placement must have rotation_deg and shift_mm, three numbers each')
    inner = _File(file.path, placement)
    turn = inner.numbers('rotation_deg', (3,), [0.0, 0.0, 0.0])
    shift = inner.numbers('shift_mm', (3,), [0.0, 0.0, 0.0]) * MM
    rotation = Rotation.from_euler('xyz', turn, degrees=True).as_matrix()
    return Placed(surface, np.asarray(rotation), shift)


#: Processor time for any file, and in addition for each MB of it [s]; memory in addition to the
#: length of the file [bytes].
SECONDS, SECONDS_PER_MB, ROOM = 8, 2, 1 << 29


def read_step_safely(path: Path, faces: Sequence[int], note: Callable[[str], None]) -> Part:
    """Read faces in a separate process, like ``step_file.read_step_part``."""
    words = [str(path), *map(str, faces)]
    # -P: import only this package and installed ones, nothing from the folder of the user.
    command = [sys.executable, '-P', '-m', 'cnc_interp.cam.surface_file', *words]
    given, own = os.environ.get('PYTHONPATH', ''), str(Path(__file__).parents[2])
    places = os.pathsep.join(filter(None, [given, own]))
    child = subprocess.run(
        command,
        env=os.environ | {'PYTHONPATH': places},
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
    )
    if code := child.returncode:
        why = f'it ended by {signal.Signals(-code).name}' if code < 0 else f'exit code {code}'
        if code == -signal.SIGXCPU:
            why = 'reading it takes too long for a file of its size'
        raise SurfaceError(f'{path}: OpenCASCADE cannot read it: {why}')
    part, notes, refusal = pickle.loads(child.stdout)
    for text in notes:
        note(text)
    refuse_if(refusal, SurfaceError(refusal))
    read: Part = part
    return read


def answer(path: Path, faces: Sequence[int]) -> tuple[Part | None, list[str], str]:
    notes: list[str] = []
    try:
        length = path.stat().st_size if path.is_file() else 0
        most = SECONDS + SECONDS_PER_MB * length // 1_000_000
        resource.setrlimit(resource.RLIMIT_CPU, (most, most + 1))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        BoundedMemory(*[path] * (length > 0), room=ROOM)
        return read_step_part(path, faces, notes.append), notes, ''
    except SurfaceError as refusal:
        return None, notes, str(refusal)
    except MemoryError:
        return (
            None,
            notes,
            f'{path}: it would unpack to far more than a file of this size can contain',
        )
    except Exception as fault:  # bindings of OpenCASCADE raise anything
        reason = ' '.join(str(fault).split())[:200] or type(fault).__name__
        return None, notes, f'{path}: cannot be read ({reason})'


def main() -> None:
    output = os.fdopen(os.dup(1), 'wb')
    os.dup2(2, 1)  # what OpenCASCADE prints is no part of the answer
    with output:
        pickle.dump(answer(Path(sys.argv[1]), [int(word) for word in sys.argv[2:]]), output)
        output.flush()
        os._exit(0)  # destructors of OpenCASCADE may crash, too


if __name__ == '__main__':
    main()
