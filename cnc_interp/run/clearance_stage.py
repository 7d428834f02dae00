"""The stage that checks clearances, between kinematics and feed planner. It needs a scene."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from cnc_interp.core import MM, BoolArray, FloatArray, IntArray, InterpError, StreamError
from cnc_interp.kinematics.axis_path import AxisPath
from cnc_interp.machine_model.machine import Machine
from cnc_interp.program.blocks import Blocks
from cnc_interp.program.blocks.functions import Functions
from cnc_interp.program.job import JobSetup
from cnc_interp.settings.options import Settings

if TYPE_CHECKING:
    from cnc_interp.collision.follow import CutStock
    from cnc_interp.collision.hits import Hit
    from cnc_interp.collision.path_clearance import Certificates, PathClearance

REFUSE = 'refuse'
TIP_MOVES = 1e-9  #: A tip that moves less than this in a path cell rests [m].
PLACES = 20_000  #: Number of surface points whose excess is stored for the report.


def clearance_of(
    machine: Machine, settings: Settings, most_hits: int = 0, setup: str | None = None
) -> PathClearance | None:
    """Return the clearance check with the scene of the settings; None without a scene.

    ``setup``: text of the setup with the tool table; by default from the file in the settings.
    """
    if settings.scene is None:
        return None
    from cnc_interp.collision.path_clearance import MOST_HITS, PathClearance
    from cnc_interp.collision.scene_file import read_scene

    setup = setup_text(settings.setup) if setup is None else setup
    return PathClearance(machine, read_scene(settings.scene, setup), most_hits or MOST_HITS)


def setup_text(file: Path | None) -> str:
    """Return the text of a setup file; '' if the file does not exist yet."""
    return '' if file is None or not file.is_file() else JobSetup.load(file).text()


class ContactError(StreamError):
    """Motion by hand was stopped, because two bodies would come too near each other."""

    def __init__(self, bodies: tuple[str, str], text: str):
        self.bodies = bodies
        super().__init__(text)


#: Function that finds the first contact on straight moves between axis positions (K, n) [m, rad].
#: It returns None, or a function that makes the error from the positions at which the axes rest.
Foresight = Callable[[FloatArray], Callable[[FloatArray], ContactError] | None]


def contact_by_hand(machine: Machine, settings: Settings, outputs: FloatArray) -> Foresight | None:
    """Return the function that predicts contacts of motion by hand; None without a scene.

    ``outputs``: values of the outputs; one of them is the number of the tool in the spindle.
    """
    clearance = clearance_of(machine, settings, 1)
    if clearance is None:
        return None
    from cnc_interp.collision.path_clearance import TOOL_OUTPUTS

    names = [signal.name for signal in machine.signals.outputs]
    place = next((k for k, name in enumerate(names) if name in TOOL_OUTPUTS), -1)

    known, tool = _changed(settings.setup), 0  # when the tool table that was read had been written

    def contact(positions: FloatArray) -> Callable[[FloatArray], ContactError] | None:
        nonlocal clearance, known, tool
        # After a run the table says which tool is in the spindle, if there is one.
        kept = tool if settings.setup is None else 0
        tool = int(outputs[place]) if place >= 0 and outputs[place] else kept
        if known != (written := _changed(settings.setup)):
            try:
                known, clearance = written, clearance_of(machine, settings, 1)
            except InterpError as problem:  # a tool of the table cannot get bodies
                raise StreamError(str(problem)) from None
        assert clearance is not None
        hit = clearance.contact(positions, tool)
        return None if hit is None else partial(_left, clearance, hit, tool)

    contact(np.zeros((2, len(machine.axis_names))))  # its kernels, before anything moves
    return contact


def _changed(file: Path | None) -> int:
    """Return the modification time of a file [ns]; 0 if it does not exist."""
    return file.stat().st_mtime_ns if file is not None and file.exists() else 0


def _left(clearance: PathClearance, hit: Hit, tool: int, rest: FloatArray) -> ContactError:
    left = clearance.distance(hit.bodies, rest, tool)
    one, other = hit.names
    text = f'stopped before a contact of {one} and {other}; {left / MM:.3g} mm are left'
    return ContactError(hit.bodies, text)


class LiveClearance:
    """Checks each part of a run's path before the feed planner gets it; a hit ends the run."""

    def __init__(self, clearance: PathClearance, mode: str, line_of: Callable[[int], int]):
        self._clearance, self._mode, self._line_of = clearance, mode, line_of
        self._functions = Functions.none()
        #: Hits so far. The first one ends the run, unless the settings demand only warnings.
        self.hits: list[Hit] = []
        self.stock: CutStock | None = None  #: Stock at the end of the part checked last.

    @staticmethod
    def of(
        machine: Machine, settings: Settings, line_of: Callable[[int], int]
    ) -> LiveClearance | None:
        most = 1 if settings.collision == REFUSE else 0
        clearance = clearance_of(machine, settings, most)
        return None if clearance is None else LiveClearance(clearance, settings.collision, line_of)

    def call_tools(self, functions: Functions) -> None:
        self._functions = Functions.concatenate([self._functions, functions])
        self._clearance.call_tools(self._functions)

    def check(self, path: AxisPath) -> None:
        """Raise CollisionError if a part of the path hits something. Infinite feed: a rapid."""
        from cnc_interp.collision.hits import CollisionError

        hits, _ = self._clearance.push(path, rapid_cells(path), self._line_of)
        self.stock = self._clearance.stock
        self.hits += hits
        if hits and self._mode == REFUSE:
            raise CollisionError(hits[0].text(self._clearance.machine), hits[0].line)

    def pass_by(self, path: AxisPath) -> None:
        """Cut the stock along a part of the path that this run does not execute again."""
        self._clearance.pass_by(path, rapid_cells(path), self._functions)

    def stock_text(self) -> str:
        """Return one line about the removed stock; '' without a stock."""
        from cnc_interp.run.plan_figures import stock_text

        return '' if self.stock is None else stock_text(self.stock.figures())


def rapid_cells(path: AxisPath) -> BoolArray:
    """Return which path cells are rapids: cells without a feed in which the tip moves."""
    moves = np.linalg.norm(np.diff(path.tip, axis=0), axis=1) > TIP_MOVES
    return np.asarray(np.isinf(path.cell_feed) & moves)


class ClearanceStage:
    """Checks a program while it is planned; ``hits``: all hits found so far."""

    def __init__(self, clearance: PathClearance, mode: str):
        self.clearance, self.mode = clearance, mode
        self.hits: list[Hit] = []
        self._rapid: BoolArray = np.zeros(0, dtype=np.bool_)
        self._whole: BoolArray = np.zeros(
            0, dtype=np.bool_
        )  # of the program before the start, too
        self._functions = Functions.none()
        self._line: IntArray = np.zeros(0, dtype=np.int64)

    @staticmethod
    def of(machine: Machine, settings: Settings, setup: str) -> ClearanceStage | None:
        clearance = clearance_of(machine, settings, setup=setup)
        return None if clearance is None else ClearanceStage(clearance, settings.collision)

    @property
    def refused(self) -> bool:
        return bool(self.hits) and self.mode == REFUSE

    def rows(self, blocks: Blocks, functions: Functions | None = None) -> None:
        """Add the next rows of the executed program, and the functions up to their end."""
        self._rapid = np.concatenate([self._rapid, blocks.rapid])
        self._line = np.concatenate([self._line, blocks.line_number])
        if functions is not None:
            self.clearance.call_tools(functions)

    def check(self, path: AxisPath) -> Certificates:
        rapid = self._rapid[path.cell_block]
        hits, found = self.clearance.push(path, rapid, lambda row: int(self._line[row]))
        self.hits += hits
        return found

    def program(self, blocks: Blocks, functions: Functions) -> None:
        """Add the next rows of the whole program, if the run starts inside it."""
        self._whole = np.concatenate([self._whole, blocks.rapid])
        self._functions = functions

    def pass_by(self, path: AxisPath) -> None:
        """Cut the stock along a part of the path that is not executed."""
        self.clearance.pass_by(path, self._whole[path.cell_block], self._functions)

    def save_stock(self, directory: Path) -> None:
        """Write the remaining stock as STL, if the scene has a stock."""
        if self.clearance.stock is None:
            return
        from cnc_interp.collision.mesh_file import stl_of
        from cnc_interp.collision.rest import stock_triangles

        content = stl_of(stock_triangles(self.clearance.stock) / MM, 'stock in mm')
        (directory / 'stock.stl').write_bytes(content)

    def save_stages(self, directory: Path, count: int) -> None:
        """Write the stock surface at about ``count`` stages, for drawings; see ``stages_of``."""
        if self.clearance.stock is None or not count:
            return
        from cnc_interp.collision.rest import stages_of

        places, surfaces = zip(*stages_of(self.clearance.stock, count), strict=True)
        np.savez_compressed(
            directory / 'stock_stages.npz',
            s=np.array(places),
            triangles=np.array([len(found) for found in surfaces]),
            corners=np.concatenate(surfaces).astype(np.float32),
        )

    def stock_columns(self) -> dict[str, dict[str, Any]]:
        """Return plan file -> columns for the files about the stock; {} without a stock."""
        if self.clearance.stock is None:
            return {}
        removal, remaining = self.clearance.stock.columns()
        found = {'removal': removal, 'remaining': remaining}
        if (rest := self._rest) is not None and len(rest[0]):
            some = np.linspace(0, len(rest[0]) - 1, min(len(rest[0]), PLACES)).astype(int)
            some = np.append(some, [rest[1].argmin(), rest[1].argmax()])
            found['rest'] = {'place': rest[0][some], 'excess': rest[1][some]}
        return found

    @cached_property
    def _rest(self) -> tuple[FloatArray, FloatArray] | None:
        stock, part = self.clearance.stock, self.clearance.scene.part
        if stock is None or part is None:
            return None
        from cnc_interp.collision.rest import against_part

        return against_part(stock, part)

    def _stock_summary(self) -> dict[str, Any]:
        stock = self.clearance.stock
        if stock is None:
            return {}
        found = stock.figures() | {'hits': sum(hit.material for hit in self.hits)}
        if self._rest is not None:
            found['excess'] = float(self._rest[1].max(initial=0.0))
            found['gouge'] = float(-self._rest[1].min(initial=0.0))
        return {'stock': found}

    def require(self, source: str) -> None:
        """Raise an error with a line for each hit, if there are hits and they are not allowed."""
        from cnc_interp.collision.hits import CollisionsError

        if self.refused:
            raise CollisionsError(self.hits, self.clearance.machine, source)

    def summary(self) -> dict[str, Any]:
        figures, machine = self.clearance.figures, self.clearance.machine
        return {
            'scene': str(self.clearance.scene.source),
            'mode': self.mode,
            'bodies': len(self.clearance.scene.bodies),
            'pairs': figures.pairs,
            'intervals': figures.intervals,
            'certificates': figures.certificates,
            'nearest': None if figures.nearest is None else asdict(figures.nearest),
            'hits': [hit.to_json(machine) for hit in self.hits],
            **self._stock_summary(),
        }
