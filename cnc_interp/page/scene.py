"""The machine in three dimensions: moving axes, the tool, and its path as a coloured tube."""

from __future__ import annotations

import json
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
from nicegui import ui
from scipy.spatial.transform import Rotation

from cnc_interp.core import FloatArray, IntArray
from cnc_interp.description import urdf
from cnc_interp.machine_model.joint import TOOL_TIP, WORKPIECE, Joint
from cnc_interp.machine_model.links import BASE
from cnc_interp.page.preview import Preview
from cnc_interp.page.start_choice import WayThere

if TYPE_CHECKING:
    from cnc_interp.collision.drawing import DrawnBody

SIDES = 5  #: Number of sides of the tube.
FACES = 2 * SIDES  #: Number of triangles between two neighbouring points.
#: Points are left out if the tube then moves by less than this share of its radius, and if red,
#: green and blue change by less than this share of their range.
UNSEEN, INDISTINCT = 0.25, 0.04
#: Colours from slow to fast, evenly spaced and legible on a dark background.
SCALE = ((58, 84, 196), (43, 176, 220), (96, 204, 120), (244, 208, 63), (231, 90, 60))


def tube(
    points: FloatArray, values: FloatArray, top: float, radius: float
) -> tuple[bytes, IntArray]:
    """Make the file from which ``scene.js`` draws the tube.

    Returns
    -------
    bytes
        Radius and points [m] as 32-bit floats, then red, green, blue and opacity of each point.
    ndarray, shape (k,)
        The rows of ``points`` that are drawn.

    """
    colours = colours_of(values, top)
    kept = thinned(np.column_stack([points / (UNSEEN * radius), colours / (255.0 * INDISTINCT)]))
    kept = kept[np.r_[True, np.abs(np.diff(points[kept], axis=0)).max(axis=1) > 0.0]]
    drawn = points[kept]
    if len(kept) < 2:
        drawn, kept = points[kept] + [[0.0, 0.0, 0.0], [0.0, 0.0, radius]], kept[[0, 0]]
    file = np.append(radius, drawn).astype('<f4').tobytes() + colours[kept].tobytes()
    return file, kept


def thinned(points: FloatArray) -> Any:
    """Choose rows of a polyline so that no point is farther than 1 from its chord (Peucker)."""
    kept = np.zeros(len(points), dtype=bool)
    kept[[0, -1]] = True
    waiting = [(0, len(points) - 1)]
    while waiting:
        first, last = waiting.pop()
        off = points[first + 1 : last] - points[first]
        chord = points[last] - points[first]
        along = np.clip(off @ chord / max(chord @ chord, np.finfo(float).tiny), 0.0, 1.0)
        square = ((off - along[:, None] * chord) ** 2).sum(axis=1)
        if square.max(initial=0.0) > 1.0:
            worst = first + 1 + int(square.argmax())
            kept[worst] = True
            waiting += [(first, worst), (worst, last)]
    return np.flatnonzero(kept)


def colours_of(values: FloatArray, top: float) -> Any:
    """Return red, green, blue and opacity of values on the scale, shape (N, 4), bytes."""
    place = np.clip(values / top, 0.0, 1.0) if top > 0.0 else np.zeros(len(values))
    known = np.linspace(0.0, 1.0, len(SCALE))
    rgb = [np.interp(place, known, [colour[k] for colour in SCALE]) for k in range(3)]
    return np.stack([*rgb, np.full(len(values), 255.0)], axis=1).round().astype(np.uint8)


GROUND = '#26323c'
#: Directions of view [-], by name; the first is the default.
VIEWS = {
    'iso': (0.55, -0.70, 0.46),
    'top': (0.0, -0.001, 1.0),
    'front': (0.0, -1.0, 0.0),
    'right': (1.0, 0.0, 0.0),
}
#: Axes of the workpiece: colours, and length and radius relative to the size of the view.
TRIAD = {'X': '#ff6b6b', 'Y': '#5fd38d', 'Z': '#5aa9e6'}
TRIAD_LENGTH, TRIAD_RADIUS = 0.22, 0.006
#: Colour of the executed part of the path.
DONE = '#5d6d79'
RAY, RAY_COLOUR = 0.14, '#ffd166'
#: The approach to a place inside the program: colours, and radius relative to the view's size.
WAY, WAY_RADIUS = '#ff5ec4', 0.004
FOV = 40.0
#: Bodies that the view of the part leaves out.
MACHINE_LINKS = (BASE, 'x_slide', 'y_slide', 'z_slide', WORKPIECE)
#: Opacity of the tool's side in the view of the part, so that the cutting point is visible.
SEE_THROUGH = 0.3
SOLID = 0.9  #: Opacity of the stock while it is cut, so that walls and floors are visible.


class MachineView:
    def __init__(self, description: urdf.Description):
        self._description = description
        self._of_part = True
        self._placed: tuple[bool, dict[str, float]] = (True, {})  # what is shown
        self._path: Any = None
        self._shown = self._done = -1
        self._direction = np.array(VIEWS['iso'])
        self._triad: Any = None
        self._zero: tuple[float, ...] = (0.0,) * 4  # X Y Z of the work offset in W [m], turn [rad]
        self._legs: tuple[tuple[str, FloatArray], ...] = ()
        self._drawn_way: Any = None
        self._hidden: list[Any] = []
        self._carriers: list[tuple[Any, urdf.Colour]] = []  # what carries the tool, and the tool
        self._bodies: list[tuple[Any, DrawnBody]] = []
        self._uncut: list[Any] = []  # the stock before the program
        self._cut: Any = None
        self._stage = -1
        self._hit: tuple[str, ...] = ()
        self._tool = 0
        joints = {joint.child: joint.parent for joint in description.joints}
        link, self._tool_side = TOOL_TIP, {TOOL_TIP}
        while link in joints:
            link = joints[link]
            self._tool_side.add(link)
        self._joints: dict[str, tuple[Joint, Any]] = {}
        camera = ui.scene.perspective_camera(fov=FOV, near=0.005, far=20.0)
        self._scene = ui.scene(grid=False, camera=camera, background_color=GROUND, fps=10)
        self._scene.classes('scene')
        self._scene.on(
            'init', self._draw_path
        )  # again, because the browser may have lost its drawing
        with self._scene:
            self._root = self._scene.group()
            with self._root:
                self._build(description.joints[0].parent)
        self._look(np.zeros(3), 0.25)

    def _build(self, link: str) -> None:
        for shape in self._description.links[link]:
            found = self._add(shape)
            if link in MACHINE_LINKS:
                self._hidden.append(found.visible(False))
            elif link in self._tool_side:
                self._carriers.append((found, shape.colour))
        for number, body in enumerate(self._description.bodies):
            if body.link == link:
                self._add_body(number, body)
        if link == TOOL_TIP:
            ray = urdf.Shape((0.0006, RAY), (0.0, 0.0, RAY / 2), (1.0, 0.82, 0.4, 1.0))
            self._add(ray).material(RAY_COLOUR)
        if link == WORKPIECE:
            self._workpiece = self._scene.group()
        for joint in self._description.joints:
            if joint.parent == link:
                group = self._scene.group().move(*joint.origin)
                group.rotate_R(joint.turn.tolist())
                self._joints[joint.name] = joint, group
                with group:
                    self._build(joint.child)

    def _add_body(self, number: int, body: DrawnBody) -> None:
        colour = urdf.colour_of(body)
        found = self._scene.stl(f'/body/{number}.stl').material(css(colour), colour[3])
        self._bodies.append((found, body))
        if body.role.name == 'STOCK':
            self._uncut.append(found)
            self._stock = self._scene.group()
        if body.link in MACHINE_LINKS and body.link != WORKPIECE:
            self._hidden.append(found.visible(False))
        elif body.link in self._tool_side:
            self._carriers.append((found, colour))

    def mark(self, hit: tuple[str, ...], tool: int) -> None:
        """Show bodies that hit each other in red, and only the tool that is in the spindle."""
        if (hit, tool) == (self._hit, self._tool):
            return
        self._hit, self._tool = hit, tool
        self._paint()

    def show_stage(self, stage: int) -> None:
        """Show a stage of the stock while the program cuts it; -1: the uncut stock."""
        if stage == self._stage:
            return
        self._stage = stage
        if self._cut is not None:
            self._cut.delete()
            self._cut = None
        if stage >= 0 and self._uncut:
            with self._scene, self._stock:
                self._cut = self._scene.stl(f'/stock/{self._shown}/{stage}.stl')
            self._cut.material(css(urdf.STOCK), SOLID)
        self._paint()

    def _add(self, shape: urdf.Shape) -> Any:
        if shape.is_box:
            found = self._scene.box(*shape.size)
            turn = np.eye(3)
        else:
            radius, length = shape.size
            found = self._scene.cylinder(radius, radius, length, 32)
            # The cylinders of the browser's library have the axis y.
            upright = Rotation.from_euler('x', 90, degrees=True)
            turn = (Rotation.from_euler('xyz', shape.rpy) * upright).as_matrix()
        found.move(*shape.centre).rotate_R(turn.tolist())
        return found.material(css(shape.colour), shape.colour[3])

    def show(self, positions: dict[str, float]) -> None:
        """Move the axes [m, rad]; in the view of the part the workpiece does not move."""
        if (self._of_part, positions) == self._placed:
            return
        self._placed = self._of_part, positions
        for name, value in positions.items():
            joint, group = self._joints[name]
            if joint.kind == 'prismatic':
                place = np.array(joint.origin) + value * np.array(joint.along)
                group.move(*(round(float(x), 6) for x in place))
            else:
                turn = joint.turn @ Rotation.from_rotvec(value * np.array(joint.along)).as_matrix()
                group.rotate_R(turn.round(6).tolist())
        turn, place = np.eye(3), np.zeros(3)
        if self._of_part:
            rotation, origin = self._description.pose(WORKPIECE, positions)
            turn, place = rotation.T, -rotation.T @ origin
        self._root.rotate_R(turn.round(6).tolist())
        self._root.move(*(round(float(x), 6) for x in place))

    def show_path(self, number: int, plan: Preview) -> None:
        if number == self._shown:
            return
        self._shown = number
        if self._path is not None:
            self._path.delete()
        with self._scene, self._workpiece:
            self._path = self._scene.group()
        self._done = 0
        self._draw_path()
        self._stage = -1
        self.show_stage(plan.stage_at(-np.inf))
        self._extent = plan.tip.min(axis=0), plan.tip.max(axis=0)
        self._show_triad()
        self.look_at_part(self._of_part)

    def _draw_path(self) -> None:
        ui.run_javascript(f'scene.fit({self._scene.id})')
        if self._path is None:
            return
        corners = 3 * FACES * self._done
        words = self._scene.id, self._path.id, f'/path/{self._shown}', SIDES, DONE, corners
        ui.run_javascript(f'scene.show_path({", ".join(map(json.dumps, words))})')

    def clear_path(self) -> None:
        if self._path is not None:
            self._path.delete()
            self._path = None
        self._shown = -1
        self.show_stage(-1)

    def show_zero(self, place: FloatArray, turn: float) -> None:
        """Show the axes of the workpiece at the zero of the work offset [m], turned [rad]."""
        zero = (*(round(float(x), 6) for x in place), round(turn, 6))
        if zero != self._zero:
            self._zero = zero
            if self._triad is not None:
                self._show_triad()

    def show_done(self, point: int) -> None:
        if self._path is None or point == self._done:
            return
        self._done = point
        words = self._scene.id, self._path.id, 3 * FACES * point
        ui.run_javascript(f'scene.show_done({", ".join(map(json.dumps, words))})')

    def show_way(self, way: WayThere | None) -> None:
        """Show the whole approach to a position inside the program; None removes it."""
        legs = way.legs if way is not None else ()
        if legs is self._legs or self._path is None:
            return
        self._legs = legs
        if self._drawn_way is not None:
            self._drawn_way.delete()
            self._drawn_way = None
        if legs:
            with self._scene, self._workpiece:
                self._drawn_way = self._scene.group()
                with self._drawn_way:
                    bars = [bar for name, tips in legs for bar in self._draw_leg(name, tips)]
            words = self._scene.id, [bar.id for bar in bars]
            ui.run_javascript(f'scene.show_through({", ".join(map(json.dumps, words))})')
        self.look_at_part(self._of_part)

    def _draw_leg(self, name: str, tips: FloatArray) -> list[Any]:
        radius = WAY_RADIUS * 2.0 * self._size()[1]
        kept = tips[thinned(tips / (0.5 * radius))]
        bars = []
        for start, end in pairwise(kept):
            length = float(np.linalg.norm(end - start))
            along = (end - start) / length
            bars.append(self._bar(radius, length, (start + end) / 2, along, WAY))
        s = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(tips, axis=0), axis=1)))
        style = f'color: {WAY}; font-weight: 700; text-shadow: 0 0 3px #000'
        label = self._scene.text(name, style)
        label.move(*(float(np.interp(s[-1] / 2, s, column)) for column in tips.T))
        return bars

    def _bar(
        self, radius: float, length: float, centre: FloatArray, along: FloatArray, colour: str
    ) -> Any:
        turn, _ = Rotation.align_vectors(along[None], [[0.0, 1.0, 0.0]])
        found = self._scene.cylinder(radius, radius, length, 12)
        found.move(*map(float, centre)).rotate_R(turn.as_matrix().tolist()).material(colour)
        return found

    def _size(self) -> tuple[FloatArray, float]:
        """Return centre and radius of the view, which shows the path and the approach [m]."""
        low, high = self._extent
        for _, tips in self._legs:
            low, high = np.minimum(low, tips.min(axis=0)), np.maximum(high, tips.max(axis=0))
        return (low + high) / 2, max(0.03, float(np.linalg.norm(high - low)) * 0.62)

    def _show_triad(self) -> None:
        if self._triad is not None:
            self._triad.delete()
        low, high = self._extent
        size = max(0.03, float(np.linalg.norm(high - low)))
        length, radius = TRIAD_LENGTH * size, TRIAD_RADIUS * size
        with self._scene, self._workpiece:
            *place, turn = self._zero
            self._triad = self._scene.group().move(*place).rotate(0.0, 0.0, turn)
            with self._triad:
                for along, (name, colour) in zip(np.eye(3), TRIAD.items(), strict=True):
                    self._bar(radius, length, along * length / 2, along, colour)
                    label = self._scene.text(name, f'color: {colour}; font-weight: 700')
                    label.move(*(along * 1.15 * length))

    def look_from(self, name: str) -> None:
        self._direction = np.array(VIEWS[name])
        self.look_at_part(self._of_part)

    def look_at_part(self, of_part: bool) -> None:
        self._of_part = of_part
        self._paint()
        if not of_part:
            self._look(np.array([0.0, 0.0, 0.12]), 1.15)
        elif self._path is not None:
            self._look(*self._size())

    def _paint(self) -> None:
        of_part = self._of_part
        for shape in self._hidden:
            shape.visible(not of_part)
        for found, colour in self._carriers:
            found.material(css(colour), SEE_THROUGH if of_part else colour[3])
        for found, body in self._bodies:
            here, hits = body.tool in (0, self._tool), body.name in self._hit
            here &= found not in self._uncut or self._cut is None
            there = found not in self._hidden or not of_part or hits
            found.visible(here and there)
            if hits:
                found.material(css(urdf.HIT), 1.0)
            elif (found, urdf.colour_of(body)) not in self._carriers:
                found.material(css(urdf.colour_of(body)), urdf.colour_of(body)[3])

    def _look(self, centre: FloatArray, radius: float) -> None:
        distance = radius / np.sin(np.radians(FOV / 2))
        place = centre + distance * self._direction / np.linalg.norm(self._direction)
        self._scene.move_camera(
            *(float(x) for x in place), *(float(x) for x in centre), 0.0, 0.0, 1.0, duration=0.0
        )


def css(colour: urdf.Colour) -> str:
    return '#' + ''.join(f'{round(255 * x):02x}' for x in colour[:3])
