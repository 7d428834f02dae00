"""The machine in three dimensions: moving axes, the tool, and the path on the workpiece."""

from __future__ import annotations

import json
from itertools import pairwise
from typing import Any

import numpy as np
from nicegui import ui
from scipy.spatial.transform import Rotation

from cnc_interp.client.page.preview import Preview
from cnc_interp.client.page.start_choice import Way
from cnc_interp.client.page.tube import FACES, thinned
from cnc_interp.core.arrays import FloatArray
from cnc_interp.description.links import (
    BASE,
    TOOL_TIP,
    WORKPIECE,
    Description,
    Joint,
)
from cnc_interp.description.shapes import Colour, Shape

GROUND = '#26323c'
#: Directions from which one looks [-], by name; the first is the usual one.
VIEWS = {
    'iso': (0.55, -0.70, 0.46),
    'top': (0.0, -0.001, 1.0),
    'front': (0.0, -1.0, 0.0),
    'right': (1.0, 0.0, 0.0),
}
#: Axes of the workpiece: their colours, and their length and radius relative to what is looked at.
TRIAD = {'X': '#ff6b6b', 'Y': '#5fd38d', 'Z': '#5aa9e6'}
TRIAD_LENGTH, TRIAD_RADIUS = 0.22, 0.006
#: Part of the path that is executed already.
DONE = '#5d6d79'
RAY, RAY_COLOUR = 0.14, '#ffd166'
#: The way to a place inside the program; its radius relative to what is looked at.
WAY, WAY_RADIUS = '#ff5ec4', 0.004
FOV = 40.0
#: What the view of the part leaves out.
MACHINE_LINKS = (BASE, 'x_slide', 'y_slide', 'z_slide', WORKPIECE)


class MachineView:
    """The 3-D view of one page."""

    def __init__(self, description: Description):
        self._description = description
        self._of_part = True
        self._path: Any = None
        self._shown = self._done = -1
        self._direction = np.array(VIEWS['iso'])
        self._triad: Any = None
        self._legs: tuple[tuple[str, FloatArray], ...] = ()
        self._drawn_way: Any = None
        self._hidden: list[Any] = []
        self._joints: dict[str, tuple[Joint, Any]] = {}
        camera = ui.scene.perspective_camera(fov=FOV, near=0.005, far=20.0)
        self._scene = ui.scene(grid=False, camera=camera, background_color=GROUND, fps=10)
        self._scene.classes('scene')
        with self._scene:
            self._root = self._scene.group()
            with self._root:
                self._build(BASE)
        self._look(np.zeros(3), 0.25)

    def _build(self, link: str) -> None:
        """Add the shapes of a link, then the links attached to it."""
        for shape in self._description.links[link]:
            found = self._add(shape)
            if link in MACHINE_LINKS:
                self._hidden.append(found.visible(False))
        if link == TOOL_TIP:
            ray = Shape((0.0006, RAY), (0.0, 0.0, RAY / 2), (1.0, 0.82, 0.4, 1.0))
            self._add(ray).material(RAY_COLOUR)
        if link == WORKPIECE:
            self._workpiece = self._scene.group()
        for joint in self._description.joints:
            if joint.parent == link:
                group = self._scene.group().move(*joint.origin)
                self._joints[joint.name] = joint, group
                with group:
                    self._build(joint.child)

    def _add(self, shape: Shape) -> Any:
        """Add one shape at its place in the link."""
        if shape.is_box:
            found = self._scene.box(*shape.size)
            turn = np.eye(3)
        else:
            radius, length = shape.size
            found = self._scene.cylinder(radius, radius, length, 32)
            # The cylinders of the browser's library stand along y.
            upright = Rotation.from_euler('x', 90, degrees=True)
            turn = (Rotation.from_euler('xyz', shape.rpy) * upright).as_matrix()
        found.move(*shape.centre).rotate_R(turn.tolist())
        return found.material(css(shape.colour), shape.colour[3])

    def show(self, positions: dict[str, float]) -> None:
        """Move the axes [m, rad]; in the view of the part the workpiece stands still."""
        for name, value in positions.items():
            joint, group = self._joints[name]
            if joint.kind == 'prismatic':
                place = np.array(joint.origin) + value * np.array(joint.along)
                group.move(*(round(float(x), 6) for x in place))
            else:
                turn = Rotation.from_rotvec(value * np.array(joint.along)).as_matrix()
                group.rotate_R(turn.round(6).tolist())
        turn, place = np.eye(3), np.zeros(3)
        if self._of_part:
            rotation, origin = self._description.pose(WORKPIECE, positions)
            turn, place = rotation.T, -rotation.T @ origin
        self._root.rotate_R(turn.round(6).tolist())
        self._root.move(*(round(float(x), 6) for x in place))

    def show_path(self, number: int, plan: Preview | None) -> None:
        """Show the path with this number; it is fetched by the browser once."""
        if number == self._shown or plan is None:
            return
        self._shown = number
        if self._path is not None:
            self._path.delete()
        with self._scene, self._workpiece:
            self._path = self._scene.gltf(f'/path/{number}.glb')
        self._extent = plan.tip.min(axis=0), plan.tip.max(axis=0)
        self._done = 0
        self._show_triad()
        self.look_at_part(self._of_part)

    def show_done(self, point: int) -> None:
        """Show the path up to one of its drawn points as executed."""
        if self._path is None or point == self._done:
            return
        self._done = point
        words = self._scene.id, self._path.id, DONE, 3 * FACES * point
        ui.run_javascript(f'scene.show_done({", ".join(map(json.dumps, words))})')

    def show_way(self, way: Way | None) -> None:
        """Show the way to a place inside the program, and look at all of it; None removes it."""
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
        """Draw one part of the way, its name at the middle; return its bars."""
        radius = WAY_RADIUS * 2.0 * self._size()[1]
        kept = tips[thinned(tips / (0.5 * radius))]
        bars = []
        for start, end in pairwise(kept):
            length = float(np.linalg.norm(end - start))
            along = (end - start) / length
            bars.append(self._bar(radius, length, (start + end) / 2, along, WAY))
        s = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(tips, axis=0), axis=1)))
        label = self._scene.text(
            name, f'color: {WAY}; font-weight: 700; text-shadow: 0 0 3px #000'
        )
        label.move(*(float(np.interp(s[-1] / 2, s, column)) for column in tips.T))
        return bars

    def _bar(
        self, radius: float, length: float, centre: FloatArray, along: FloatArray, colour: str
    ) -> Any:
        """Add a cylinder; those of the browser's library stand along y."""
        turn, _ = Rotation.align_vectors(along[None], [[0.0, 1.0, 0.0]])
        found = self._scene.cylinder(radius, radius, length, 12)
        found.move(*map(float, centre)).rotate_R(turn.as_matrix().tolist()).material(colour)
        return found

    def _size(self) -> tuple[FloatArray, float]:
        """Return centre and radius of what is looked at: the path, and the way to it [m]."""
        low, high = self._extent
        for _, tips in self._legs:
            low, high = np.minimum(low, tips.min(axis=0)), np.maximum(high, tips.max(axis=0))
        return (low + high) / 2, max(0.03, float(np.linalg.norm(high - low)) * 0.62)

    def _show_triad(self) -> None:
        """Show the axes of the workpiece at its zero, as large as the path asks for."""
        if self._triad is not None:
            self._triad.delete()
        low, high = self._extent
        size = max(0.03, float(np.linalg.norm(high - low)))
        length, radius = TRIAD_LENGTH * size, TRIAD_RADIUS * size
        with self._scene, self._workpiece:
            self._triad = self._scene.group()
            with self._triad:
                for along, (name, colour) in zip(np.eye(3), TRIAD.items(), strict=True):
                    self._bar(radius, length, along * length / 2, along, colour)
                    label = self._scene.text(name, f'color: {colour}; font-weight: 700')
                    label.move(*(along * 1.15 * length))

    def look_from(self, name: str) -> None:
        """Look from one of ``VIEWS``."""
        self._direction = np.array(VIEWS[name])
        self.look_at_part(self._of_part)

    def look_at_part(self, of_part: bool) -> None:
        """Show the part at rest, or the whole machine."""
        self._of_part = of_part
        for shape in self._hidden:
            shape.visible(not of_part)
        if not of_part:
            self._look(np.array([0.0, 0.0, 0.12]), 1.15)
        elif self._path is not None:
            self._look(*self._size())

    def _look(self, centre: FloatArray, radius: float) -> None:
        """Place the camera so that a sphere fills the view."""
        distance = radius / np.sin(np.radians(FOV / 2))
        place = centre + distance * self._direction / np.linalg.norm(self._direction)
        self._scene.move_camera(
            *(float(x) for x in place), *(float(x) for x in centre), 0.0, 0.0, 1.0, duration=0.0
        )


def css(colour: Colour) -> str:
    """Return a colour as the browser writes it."""
    return '#' + ''.join(f'{round(255 * x):02x}' for x in colour[:3])
