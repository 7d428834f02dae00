"""The YAML file of a scene; lengths in mm, angles in degrees, as the keys say."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from math import isfinite
from pathlib import Path
from typing import Any

import numpy as np

from cnc_interp.collision import shapes
from cnc_interp.collision.mesh_file import SceneError, triangles_of
from cnc_interp.collision.pieces import triangle_tree
from cnc_interp.collision.scene import Body, Role, Scene
from cnc_interp.collision.shapes import Piece
from cnc_interp.core import MM, FloatArray
from cnc_interp.core.small_files import UnreadableError, config_directory, read_yaml
from cnc_interp.machine_model.joint import TOOL_TIP, rotation
from cnc_interp.program.job import JobSetup, Tool

UNITS = {'mm': MM, 'm': 1.0, 'inch': 25.4 * MM}
#: Extents of a body outside these limits suggest a wrong unit [m].
LARGEST, SMALLEST = 50.0, 0.5 * MM
CLEARANCES = ('default', 'holder_stock', 'shank_stock', 'cutter_stock')
DEFAULT_CLEARANCE, MOST_CLEARANCE = 0.1 * MM, 50.0 * MM
SHAPES = ('box_mm', 'cylinder_mm', 'sphere_mm', 'profile_mm', 'hull_mm', 'mesh')
PLACE = ('link', 'at_mm', 'turn_deg', 'along')
MESH = ('unit', 'chord_mm')
BODY = ('name', *SHAPES, *PLACE, *MESH)
TOOL = ('diameter_mm', 'corner_mm', 'flute_mm', 'shank_mm', 'holder_mm', 'length_mm')
STOCK = (*BODY, 'grid_mm')
WHOLE = (
    'include',
    'clearance_mm',
    'bodies',
    'tools',
    'tool',
    'holders',
    'stock',
    'part',
    'ignore',
)
AXES = {'X': (1.0, 0.0, 0.0), 'Y': (0.0, 1.0, 0.0), 'Z': (0.0, 0.0, 1.0)}
CHORD = 0.01 * MM
#: Cell width of the stock: usual [mm], limits [m].
GRID, FINEST, COARSEST = 0.4, 1e-2 * MM, 10.0 * MM
MOST_LINES = 1 << 22  #: Largest number of lines of a stock along one axis.


def scenes_directory() -> Path:
    return config_directory() / 'scenes'


def find_scene_file(path_or_name: str | Path) -> Path:
    """Return the path of a scene file, given its path or the name of a bundled scene."""
    path = Path(path_or_name)
    bundled = scenes_directory() / f'{path.name}.yaml'
    return bundled if not path.is_file() and bundled.is_file() else path


def read_scene(path: Path, setup: str = '') -> Scene:
    """Read a scene; SceneError names the file, the entry and what to do, in one line.

    ``setup``: text of a setup. The tools of its table get bodies unless the scene describes them.
    The tool in its spindle becomes ``first_tool``.
    """
    path = find_scene_file(path)
    scene = _Reading(path, JobSetup.of_text(setup)).scene(_content(path))
    if not scene.bodies:
        raise SceneError(f'{path}: bodies: the scene has no body; add one')
    return scene


def require_tool(scene: Scene, number: int, tool: Tool) -> None:
    """Raise SceneError if a tool of the tool table cannot get bodies in a scene.

    ``scene``: read without a tool table, so that it has only the tools that it describes itself.
    """
    reading = _Reading(scene.source)
    given = reading.of_table(number, tool.worn, scene.holders)
    if given and number not in scene.tools:
        reading.tool(number, given)


def _content(path: Path) -> Any:
    try:
        return read_yaml(path)
    except FileNotFoundError:
        known = ', '.join(sorted(file.stem for file in scenes_directory().glob('*.yaml')))
        text = f'no such file, and no bundled scene of that name; bundled: {known}'
        raise SceneError(f'{path}: {text}') from None
    except (OSError, UnreadableError) as problem:
        text = ' '.join(str(problem).split())
        raise SceneError(f'{path}: cannot be read as YAML: {text}') from None


NO_BODIES = Scene(Path(), (), {'default': DEFAULT_CLEARANCE}, frozenset(), (), 0)
NO_TABLE = JobSetup()
HOLDER = 'default'  #: Holder of a tool without a holder in the tool table.


class _Reading:
    def __init__(self, path: Path, setup: JobSetup = NO_TABLE):
        self._path, self._setup = path, setup
        self._meshes: list[Path] = []

    def _included(self, value: Any) -> Scene:
        """Return the scene to include; it is read first and may not include another scene."""
        if not isinstance(value, str):
            raise self.fault('include', 'must be a scene file, or the name of a bundled one')
        beside = self._path.parent / value
        path = beside if beside.is_file() else find_scene_file(value)
        content = _content(path)
        if isinstance(content, dict) and 'include' in content:
            raise self.fault(
                'include', f'{path} includes a scene itself; include a scene without include'
            )
        return _Reading(path).scene(content)

    def fault(self, where: str, text: str) -> SceneError:
        return SceneError(f'{self._path}: {where}: {text}')

    def scene(self, content: Any) -> Scene:
        whole = self._mapping(content, 'the file', WHOLE)
        given = self._mapping(whole.get('clearance_mm') or {}, 'clearance_mm', CLEARANCES)
        before = self._included(whole['include']) if 'include' in whole else NO_BODIES
        clearances = dict(before.clearances)
        for key, value in given.items():
            clearances[key] = self._length(value, f'clearance_mm.{key}', MOST_CLEARANCE)
        tools = whole.get('tools') or {}
        bodies = [body for body in before.bodies if not body.tool or not tools]
        bodies += [
            self._body(one, f'bodies[{k}]') for k, one in enumerate(self._list(whole, 'bodies'))
        ]
        grid, part = before.grid, before.part
        if whole.get('stock') is not None:
            stock = {'name': 'stock', **self._mapping(whole['stock'], 'stock', STOCK)}
            size = stock.pop('grid_mm', GRID)
            bodies = [body for body in bodies if body.role is not Role.STOCK]
            bodies.append(self._body(stock, 'stock', Role.STOCK))
            grid = self._grid(size, bodies[-1])
        if whole.get('part') is not None:
            stocks = [body for body in bodies if body.role is Role.STOCK]
            if not stocks:
                raise self.fault('part', 'is compared with the stock; describe the stock, too')
            given = {'name': 'part', 'link': stocks[0].link}
            given |= self._mapping(whole['part'], 'part', BODY)
            part = self._body(given, 'part', Role.PART)
            if part.triangles is None or part.link != stocks[0].link:
                raise self.fault('part', 'must be a mesh on the link of the stock')
        names = [body.name for body in bodies if not body.tool]
        for name in names:
            if names.count(name) > 1 or name in ('cutter', 'shank', 'holder'):
                raise self.fault('bodies', f'the name {name!r} is used twice; rename one body')
        if not isinstance(tools, dict):
            raise self.fault(
                'tools', 'must map tool numbers to tools, such as {3: {diameter_mm: 6}}'
            )
        for number, tool in tools.items():
            if isinstance(number, bool) or not isinstance(number, int) or number < 1:
                raise self.fault(
                    f'tools.{number}', 'the tool number must be a whole number above 0'
                )
            bodies += self.tool(number, self._mapping(tool, f'tools.{number}', TOOL))
        numbers = tuple(tools) or before.tools
        first = whole.get('tool', numbers[0] if len(numbers) == 1 else 0)
        if first and first not in numbers:
            raise self.fault('tool', f'tool {first} has no entry under tools')
        holders = {**before.holders, **self._mapping_of_any(whole, 'holders')}
        for number, tool in sorted(self._setup.tools.items()):
            if number not in numbers and (given := self.of_table(number, tool.worn, holders)):
                bodies += self.tool(number, given)
                numbers += (number,)
        first = self._setup.tool if self._setup.tool in numbers else first
        names += ['cutter', 'shank', 'holder']
        ignored = []
        for k, pair in enumerate(self._list(whole, 'ignore')):
            if not isinstance(pair, list) or len(pair) != 2:
                raise self.fault(f'ignore[{k}]', 'must be two names, such as [ram, nose]')
            for name in pair:
                if name not in names:
                    raise self.fault(f'ignore[{k}]', f'no body has the name {name!r}')
            ignored.append(frozenset(pair))
        return Scene(
            self._path,
            tuple(bodies),
            clearances,
            before.ignored | frozenset(ignored),
            numbers,
            first,
            holders,
            (*before.files, before.source, *self._meshes),
            grid,
            part,
        )

    def of_table(self, number: int, tool: Tool, holders: Mapping[str, Any]) -> dict[str, Any]:
        """Return the entry of ``tools`` for a tool of the table; empty if the tool has no sizes.

        If no flute length is given, the whole length below the holder counts as cutting.
        """
        if tool.holder and tool.holder not in holders:
            known = f'known: {", ".join(holders)}' if holders else 'the scene describes no holder'
            text = f'tool {number} of the tool table has the unknown holder {tool.holder!r}'
            raise self.fault('holders', f'{text}; {known}')
        if min(tool.radius, tool.length) <= 0.0:
            return {}
        where = f'holders.{tool.holder or HOLDER}'
        rows = holders.get(tool.holder or HOLDER)
        radius, length, corner = tool.radius, tool.length, tool.corner_radius or 0.0
        given: dict[str, Any] = {'diameter_mm': 2.0 * radius / MM, 'corner_mm': corner / MM}
        given |= {'flute_mm': length / MM, 'length_mm': length / MM}
        if rows:
            shifted = self._rows(rows, 2, where) / MM + [length / MM, 0.0]
            given |= {'flute_mm': float(shifted[0, 0]), 'holder_mm': shifted.tolist()}
        if 0.0 < tool.flute / MM < given['flute_mm']:
            ends = tool.flute / MM, given['flute_mm']
            given |= {'flute_mm': ends[0], 'shank_mm': [[end, radius / MM] for end in ends]}
        return given

    def _mapping_of_any(self, whole: dict[str, Any], key: str) -> dict[str, Any]:
        found = whole.get(key) or {}
        if not isinstance(found, dict):
            raise self.fault(key, 'must map names of holders to rows [height, radius]')
        return found

    def _grid(self, size: Any, body: Body) -> float:
        """Return the width of the cells in which the stock is cut [m]."""
        grid = self._length(size, 'stock.grid_mm', COARSEST, FINEST)
        low, high = body.bounds()
        if np.prod(np.sort(high - low)[1:]) > MOST_LINES * grid**2:
            raise self.fault('stock.grid_mm', 'is too fine for so large a stock; use a larger one')
        return grid

    def _mapping(self, content: Any, where: str, known: tuple[str, ...]) -> dict[str, Any]:
        if not isinstance(content, dict):
            raise self.fault(where, f'must be a mapping with keys of: {", ".join(known)}')
        for key in content:
            if key not in known:
                raise self.fault(where, f'unknown key {key!r}; known: {", ".join(known)}')
        return content

    def _list(self, whole: dict[str, Any], key: str) -> list[Any]:
        found = whole.get(key) or []
        if not isinstance(found, list):
            raise self.fault(key, 'must be a list')
        return found

    def _number(self, value: Any, where: str) -> float:
        if isinstance(value, bool) or not isinstance(value, int | float) or not isfinite(value):
            raise self.fault(where, f'must be a number, not {value!r}')
        return float(value)

    def _length(self, value: Any, where: str, most: float = LARGEST, least: float = 0.0) -> float:
        length = self._number(value, where) * MM
        if not least <= length <= most:
            text = f'{value:g} mm is not between {least / MM:g} and {most / MM:g} mm'
            raise self.fault(where, f'{text}; is the unit right?')
        return length

    def _rows(self, value: Any, width: int, where: str) -> FloatArray:
        """Return rows of lengths, (n, width) [m]."""
        rows = value if isinstance(value, list) and value else None
        if rows is None or not all(isinstance(row, list) and len(row) == width for row in rows):
            raise self.fault(where, f'must be a list of rows with {width} numbers in mm')
        return np.array([[self._number(x, where) for x in row] for row in rows]) * MM

    def _body(self, content: Any, where: str, role: Role = Role.BODY) -> Body:
        given = self._mapping(content, where, BODY)
        name = given.get('name')
        if not isinstance(name, str) or not name:
            raise self.fault(where, 'has no name')
        link, shapes_given = given.get('link'), [key for key in SHAPES if key in given]
        if not isinstance(link, str):
            raise self.fault(name, 'has no link; name the link that carries it, such as workpiece')
        if len(shapes_given) != 1:
            raise self.fault(name, f'must have one shape of: {", ".join(SHAPES)}')
        key = shapes_given[0]
        along = given.get('along', 'Z')
        if along not in AXES:
            raise self.fault(name, f'along must be X, Y or Z, not {along!r}')
        triangles, child = None, None
        if key == 'mesh':
            triangles, grown = self._mesh(given, name)
            triangles = self._placed(triangles.reshape(-1, 3), given, name).reshape(-1, 3, 3)
            if role is Role.BODY:
                pieces, child = triangle_tree(triangles, grown)
            else:  # its lines follow the mesh; the box only shows where tools are near
                corners = triangles.reshape(-1, 3)
                pieces = [shapes.box(corners.min(axis=0) - grown, corners.max(axis=0) + grown)]
        else:
            make = self._shapes[key]
            axis = np.array(AXES[along])
            pieces = [
                self._moved(p, given, name) for p in make(self, given[key], f'{name}.{key}', axis)
            ]
        return self._checked(name, link, role, pieces, child, triangles)

    def _checked(
        self,
        name: str,
        link: str,
        role: Role,
        pieces: list[Piece],
        child: Any = None,
        triangles: FloatArray | None = None,
        tool: int = 0,
    ) -> Body:
        size = max(2.0 * shapes.ball_around(piece)[3] for piece in pieces)
        if not SMALLEST <= size <= LARGEST:
            raise self.fault(name, f'it is {size / MM:.4g} mm large; is the unit right?')
        leaves = np.full((len(pieces), 2), -1, dtype=np.int64)
        roots = tuple(range(len(pieces))) if child is None else (0,)
        tree = leaves if child is None else child
        return Body(name, link, role, tuple(pieces), tree, roots, tool, triangles)

    def _box(self, value: Any, where: str, _: FloatArray) -> list[Piece]:
        ends = self._mapping(value, where, ('low', 'high'))
        low, high = (self._rows([ends.get(key)], 3, where)[0] for key in ('low', 'high'))
        if not (low < high).all():
            raise self.fault(where, 'low must be less than high in X, Y and Z')
        return [shapes.box(low, high)]

    def _cylinder(self, value: Any, where: str, along: FloatArray) -> list[Piece]:
        size = self._mapping(value, where, ('radius', 'low', 'high'))
        low, high = (self._number(size.get(key), f'{where}.{key}') * MM for key in ('low', 'high'))
        radius = self._length(size.get('radius'), f'{where}.radius', least=1e-3 * MM)
        if not low < high:
            raise self.fault(where, 'low must be less than high')
        return [shapes.stack(np.array([[low, radius], [high, radius]]), along)]

    def _sphere(self, value: Any, where: str, _: FloatArray) -> list[Piece]:
        size = self._mapping(value, where, ('radius',))
        radius = self._length(size.get('radius'), f'{where}.radius', least=1e-3 * MM)
        return [shapes.hull(np.zeros((1, 3)), radius)]

    def _profile(self, value: Any, where: str, along: FloatArray) -> list[Piece]:
        rows = self._rows(value, 2, where)
        if len(rows) < 2 or (np.diff(rows[:, 0]) < 0.0).any() or (rows[:, 1] < 0.0).any():
            raise self.fault(where, 'needs rows [height, radius] with rising heights')
        solid = [k for k in range(len(rows) - 1) if rows[k, 0] < rows[k + 1, 0]]
        return [shapes.stack(rows[k : k + 2], along) for k in solid]

    def _hull(self, value: Any, where: str, _: FloatArray) -> list[Piece]:
        return [shapes.hull(self._rows(value, 3, where))]

    _shapes: dict[str, Callable[..., list[Piece]]] = {  # noqa: RUF012
        'box_mm': _box,
        'cylinder_mm': _cylinder,
        'sphere_mm': _sphere,
        'profile_mm': _profile,
        'hull_mm': _hull,
    }

    def _mesh(self, given: dict[str, Any], name: str) -> tuple[FloatArray, float]:
        unit, value = given.get('unit', 'mm'), given['mesh']
        if unit not in UNITS:
            raise self.fault(name, f'unknown unit {unit!r}; known: {", ".join(UNITS)}')
        if not isinstance(value, str):
            raise self.fault(name, 'mesh must name an STL or STEP file')
        file = self._path.parent / value
        step = file.suffix.lower() in ('.stp', '.step')
        chord = self._length(given.get('chord_mm', CHORD / MM), f'{name}.chord_mm', 1e-2, 1e-7)
        self._meshes.append(file)
        return triangles_of(file, UNITS[unit], chord), chord if step else 0.0

    def _turn(self, given: dict[str, Any], name: str) -> tuple[FloatArray, FloatArray]:
        """Return the pose of a body in its link: rotations about X, Y, then Z, and a shift."""
        angles = given.get('turn_deg', [0.0, 0.0, 0.0])
        if not isinstance(angles, list) or len(angles) != 3:
            raise self.fault(name, 'turn_deg must be three angles about X, Y and Z')
        turns = [self._number(angle, f'{name}.turn_deg') for angle in angles]
        shift = self._rows([given.get('at_mm', [0.0, 0.0, 0.0])], 3, f'{name}.at_mm')[0]
        return rotation(*np.radians(turns)), shift

    def _placed(self, points: FloatArray, given: dict[str, Any], name: str) -> FloatArray:
        turn, shift = self._turn(given, name)
        return points @ turn.T + shift

    def _moved(self, piece: Piece, given: dict[str, Any], name: str) -> Piece:
        turn, _ = self._turn(given, name)
        discs = piece.discs.copy()
        discs[:, :3] = self._placed(discs[:, :3], given, name)
        return Piece(discs, turn @ piece.along, piece.round)

    def tool(self, number: int, given: dict[str, Any]) -> list[Body]:
        """Return cutter, shank and holder; heights are measured from the tip along the tool."""
        where = f'tools.{number}'
        for key in ('diameter_mm', 'flute_mm'):
            if key not in given:
                raise self.fault(where, f'has no {key}')
        radius = 0.5 * self._length(given['diameter_mm'], f'{where}.diameter_mm', 1.0, 1e-2 * MM)
        corner = self._length(given.get('corner_mm', 0.0), f'{where}.corner_mm', radius)
        flute = self._length(given['flute_mm'], f'{where}.flute_mm', 1.0, max(2.0 * corner, 1e-9))
        shift = -self._length(given.get('length_mm', 0.0), f'{where}.length_mm', 2.0)
        cutter = shapes.stack(np.array([[corner, radius - corner]]), round=corner)
        upper = shapes.stack(np.array([[corner, radius], [flute, radius]]))
        parts = [('cutter', Role.CUTTER, [cutter, upper] if corner else [upper])]
        rows = given.get('holder_mm')
        holder = self._profile(rows, f'{where}.holder_mm', np.array(AXES['Z'])) if rows else []
        shank = given.get('shank_mm')
        if shank is None and holder and (top := float(holder[0].discs[0, 2])) > flute:
            shank = [[flute / MM, radius / MM], [top / MM, radius / MM]]
        if shank is not None:
            found = self._profile(shank, f'{where}.shank_mm', np.array(AXES['Z']))
            parts.append(('shank', Role.SHANK, found))
        if holder:
            parts.append(('holder', Role.HOLDER, holder))
        at = {'at_mm': [0.0, 0.0, shift / MM]}
        return [
            self._checked(
                name, TOOL_TIP, role, [self._moved(p, at, where) for p in found], tool=number
            )
            for name, role, found in parts
        ]
