"""
Faces of STEP files (ISO 10303-21) as surfaces, read by OpenCASCADE (docs/how_it_works/cam.md).

The package ``cadquery-ocp-novtk`` (module ``OCP``) is optional.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from cnc_interp.cam.neighbours import Neighbours
from cnc_interp.cam.step_face import StepFace
from cnc_interp.cam.step_part import Part
from cnc_interp.cam.surface import SurfaceError
from cnc_interp.core.units import MM

#: What to do where the optional package is missing.
INSTALL = 'reading STEP needs OpenCASCADE: pip install cadquery-ocp-novtk'
SYSTEM_LIBRARY = 'OpenCASCADE cannot be loaded: apt-get install libgl1'


#: Distance of the points that stand for the faces of a part [m], and their largest number.
SPACING, MOST_POINTS = 0.25 * MM, 150_000


def read_step_part(
    path: Path, numbers: Sequence[int], note: Callable[[str], None] | None = None
) -> Part:
    """Read the surfaces of faces, and points of all faces."""
    faces = _faces(path, note)
    if not numbers and len(faces) > 1:
        lines = [f'{k:6}  {one.description()}' for k, one in enumerate(faces, 1)]
        heading = f'{path}: choose one of {len(faces)} faces with --face N:'
        raise SurfaceError('\n'.join([heading, *lines]))
    surfaces = {}
    for number in numbers or [1]:
        if not 1 <= number <= len(faces):
            raise SurfaceError(
                f'{path}: there is no face {number}; the faces are numbered from 1 to {len(faces)}'
            )
        if number in surfaces:
            raise SurfaceError(f'{path}: face {number} is named twice')
        try:
            surfaces[number] = faces[number - 1].surface()
        except SurfaceError as error:
            raise SurfaceError(f'{path}: face {number}: {error}') from error
    return Part(surfaces, _neighbours(path, faces, note))


def _neighbours(
    path: Path, faces: list[StepFace], note: Callable[[str], None] | None
) -> Neighbours | None:
    """Sample all faces of a part that has several."""
    if len(faces) == 1:
        return None
    spacing, found = SPACING, []
    for number, face in enumerate(faces, 1):
        try:
            found.append(face.samples(spacing, MOST_POINTS // len(faces)))
        except Exception as fault:  # bindings of OpenCASCADE raise anything
            found.append(np.zeros((0, 3)))
            if note:
                note(
                    f'{path}: the mill is not tested against face {number}, it has no points: '
                    f'{" ".join(str(fault).split())[:100]}'
                )
    counts = [len(points) for points in found]
    owner = np.repeat(np.arange(1, len(faces) + 1), counts)
    return Neighbours(np.ascontiguousarray(np.concatenate(found)), owner)


def _faces(path: Path, note: Callable[[str], None] | None) -> list[StepFace]:
    """Read all faces of a file, each once, without the placements of an assembly."""
    try:
        path.open('rb').close()
    except OSError as error:
        raise SurfaceError(f'{path}: cannot be opened: {error.strerror}') from error
    if not path.is_file():
        raise SurfaceError(f'{path}: it is not a file')
    try:
        from OCP.collections import Sequence_TCollection_AsciiString as Names
        from OCP.IFSelect import IFSelect_ReturnStatus
        from OCP.Message import Message
        from OCP.STEPControl import STEPControl_Reader
        from OCP.TopAbs import TopAbs_ShapeEnum
        from OCP.TopExp import TopExp_Explorer
        from OCP.TopLoc import TopLoc_Location
    except ModuleNotFoundError as error:
        raise SurfaceError(f'{path}: {INSTALL}') from error
    except ImportError as error:  # installed, but a system library is missing
        raise SurfaceError(f'{path}: {SYSTEM_LIBRARY} ({error})') from error
    messenger = Message.DefaultMessenger_s()
    for printer in list(messenger.Printers()):  # they write to standard output
        messenger.RemovePrinter(printer)
    reader = STEPControl_Reader()
    if reader.ReadFile(str(path)) != IFSelect_ReturnStatus.IFSelect_RetDone:
        raise SurfaceError(f'{path}: is not a complete STEP file')
    if faults := _faults(reader, reader.WS().ModelCheckList(True)):
        raise SurfaceError(f'{path}: {faults[0]}')
    lengths = Names()
    reader.FileUnits(lengths, Names(), Names())
    if reader.TransferRoots() == 0:
        raise SurfaceError(f'{path}: holds no shape of a product')
    if not all(name.ToCString() for name in lengths):
        raise SurfaceError(f'{path}: has no unit of length (LENGTH_UNIT)')
    faults = _faults(reader, reader.WS().TransferReader().LastCheckList())
    found: dict[Any, Any] = {}
    explorer = TopExp_Explorer(reader.OneShape(), TopAbs_ShapeEnum.TopAbs_FACE)
    while explorer.More():
        shape = explorer.Current().Located(TopLoc_Location())
        found.setdefault(shape.TShape(), shape)
        explorer.Next()
    if not found:
        raise SurfaceError(f'{path}: {(faults or ["holds no face"])[0]}')
    if note and faults:
        note(f'{path}: {len(faults)} entities were left out; {faults[0]}')
    return [StepFace(shape) for shape in found.values()]


def _faults(reader: Any, checks: Any) -> list[str]:
    """List what OpenCASCADE could not read of the geometry and topology of a file."""
    found, model = [], reader.StepModel()
    checks.Start()
    while checks.More():
        number, check = checks.Number(), checks.Value()
        kind = type(model.Value(number)).__name__ if number else ''
        if check.NbFails() and kind.startswith(('StepGeom_', 'StepShape_')):
            entity = f'entity {number} in the order of the file, {kind.split("_")[1]}'
            found.append(f'{entity}: {check.CFail(1).strip()}')
        checks.Next()
    return found
