"""Load all compiled kernels before any motion, by planning a tiny built-in path."""

import gc
import signal
import sys
from contextlib import suppress
from dataclasses import replace
from functools import cache
from multiprocessing import get_context

import numpy as np

from cnc_interp.core import MM, MM_PER_MIN, FloatArray, InterpError
from cnc_interp.feedrate.planning_windows import FeedPlanner, plan_path
from cnc_interp.feedrate.stop_law import stop_law
from cnc_interp.kinematics.axis_path import AxisPath
from cnc_interp.kinematics.path_builder import AxisPathBuilder
from cnc_interp.machine.playback import Playback
from cnc_interp.machine.simulated_drives import SimulatedDrives
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.transform_port import Transform
from cnc_interp.program import read_text
from cnc_interp.program.blocks import Blocks
from cnc_interp.run.clearance_stage import clearance_of
from cnc_interp.run.course import LIVE
from cnc_interp.run.motion_plan import MotionStream
from cnc_interp.run.overrides import OperatorSettings
from cnc_interp.run.path_chain import segments_of, way_time
from cnc_interp.run.run_state import RunId
from cnc_interp.run.setpoints import Chunk, Setpoints, Wait
from cnc_interp.settings.options import DEFAULT_MACHINE, Settings
from cnc_interp.smoothing.segments import PathSegments
from cnc_interp.smoothing.stop_choice import Way

#: Windows so short that the tiny path has several: the first one does not use all kernels.
SHORT_WINDOWS = replace(LIVE, window_cells=16)

#: A program that loads the kernels of the program reader.
TINY_TEXT = 'G21 G90 G94\nTRAORI\nG0 X0 Y0 Z0 A10 C0\nG1 X3 C5 F3000\nM30\n'


def tiny_program(transform: Transform) -> Blocks:
    """Return three blocks with a corner and an exact stop; the tool turns in them if it can."""
    rotary = np.array([[0.30, 0.20], [0.33, 0.25], [0.35, 0.32], [0.36, 0.35]])
    rotating = transform.machine.has_rotary
    axis = transform.tool_axis(rotary) if rotating else np.tile([0.0, 0.0, 1.0], (4, 1))
    return Blocks(
        tip=np.array([[0.0, 0.0, 0.0], [5.0, 0.0, 0.0], [5.0, 5.0, 1.0], [5.0, 8.0, 1.0]]) * MM,
        axis=axis,
        rotary=np.full((4, 2), np.nan),
        feedrate=np.full(4, 300.0 * MM_PER_MIN),
        duration=np.full(4, np.nan),
        rapid=np.zeros(4, dtype=np.bool_),
        exact_stop=np.array([False, False, True, True]),
        contour_tolerance=np.full(4, 0.02 * MM),
        orientation_tolerance=np.full(4, 0.02 * MM),
        line_number=np.arange(4),
        extra=np.outer(np.arange(4), np.full(len(transform.machine.extra_names), 1.0 * MM)),
    )


def dense_program(transform: Transform) -> Blocks:
    """Return a helix of short blocks between two lines; it is smoothed as a dense program."""
    count = 400
    u = np.linspace(0.0, 6.0, count)
    rotary = np.stack([0.3 + 0.01 * np.sin(u), 0.2 + 0.05 * u], axis=1)
    rotating = transform.machine.has_rotary
    pose = tiny_program(transform)[:1]
    tip = np.stack([np.cos(u), np.sin(u), 0.1 * u], axis=1) * 30.0 * MM
    tip[[0, -1]] += 50.0 * (tip[[0, -1]] - tip[[1, -2]])
    return replace(
        Blocks.concatenate([pose] * count),
        tip=tip,
        axis=transform.tool_axis(rotary) if rotating else np.tile([0.0, 0.0, 1.0], (count, 1)),
        line_number=np.arange(count),
    )


def pole_program(transform: Transform) -> Blocks:
    pole = np.array(transform.five_axis.pole)
    side = np.linalg.svd(pole[None, :])[2][1]  # any direction at right angles
    ends = tiny_program(transform)[:2]
    return replace(ends, axis=np.cos(0.2) * pole + np.outer([np.sin(0.2), -np.sin(0.2)], side))


def _endless(transform: Transform) -> Transform:
    endless = np.tile([-np.inf, np.inf], (len(transform.machine.axis_names), 1))
    return Transform.of(transform.machine.having(travel=endless))


@cache
def warm_lookahead(machine: str) -> PathSegments:
    transform = Transform.of(Machine.load(machine))
    segments_of(dense_program(transform), transform, Settings())
    way_time(_endless(transform), Settings(), Way(tiny_program(transform)))
    return segments_of(tiny_program(transform), transform, Settings())


@cache
def warm_kinematics(machine: str, period: float) -> AxisPath:
    loaded = Machine.load(machine)
    free = _endless(Transform.of(loaded))
    made = [warm_lookahead(machine)]
    if loaded.has_rotary:
        made.append(segments_of(pole_program(free), free, Settings()))
    height = Settings().flank_height
    paths = [AxisPathBuilder(free, height, period).push(segments) for segments in made]
    assert paths[0] is not None
    return paths[0]


@cache
def warm_all(machine: str, period: float) -> None:
    """Load the kernels of all stages, from the look-ahead to the setpoints."""
    warm_feed(Machine.load(machine), warm_kinematics(machine, period), period)


def warm_feed(machine: Machine, path: AxisPath, period: float) -> None:
    for options in (LIVE, SHORT_WINDOWS):
        planner = FeedPlanner(machine, options)
        planner.push(path)
        planner.finish()
    # a stop, and a change of the override
    stream = MotionStream(machine, period)
    stream.push(path)
    stream.end_leg(Wait.END)
    while not stream.current.can_sample:
        stream.current.plan()
    chunks = list(stream.current.sample())
    handed_out = sum(len(chunk.samples) for chunk in chunks)
    stream.revision(handed_out - 1, OperatorSettings(0.5))
    state = stream.current.state_at(handed_out - 1)
    assert state is not None
    stop_law(path, state[1], machine.limits.table, 0.0)


def warm_clearance(machine: Machine, settings: Settings, period: float) -> None:
    """Read the scene, and load the kernels that check clearances, if there is a scene."""
    clearance = clearance_of(machine, settings)
    if clearance is not None:
        path = warm_kinematics(machine.file or machine.name, period)
        with suppress(InterpError):  # the tiny path knows nothing of the scene
            clearance.push(path, np.zeros(len(path.s) - 1, dtype=np.bool_), int)


def path_without_kernels(machine: Machine) -> AxisPath:
    """Return a path along which all axes follow a sine; no kernels are needed to make it."""
    s, wave = np.linspace(0.0, 20.0 * MM, 41), 1.0 / (3.0 * MM)
    jets = np.stack([wave**k * np.sin(wave * s + 0.5 * np.pi * k) for k in range(4)])
    cells = jets[:, :, None] * np.full(len(machine.axis_names), 1.0 * MM)
    stop = np.zeros(len(s), dtype=np.bool_)
    stop[[0, -1]] = True
    return AxisPath(
        s=s,
        cell_left=cells[:, :-1].copy(),  # contiguous as those of real paths: no second form
        cell_right=cells[:, 1:].copy(),
        tip=np.outer(s, [1.0, 0.0, 0.0]),
        axis=np.tile([0.0, 0.0, 1.0], (len(s), 1)),
        cell_feed=np.full(len(s) - 1, 300.0 * MM_PER_MIN),
        cell_block=np.zeros(len(s) - 1, dtype=np.int64),
        stop=stop,
    )


def resting_chunk(position: FloatArray, period: float) -> Chunk:
    number, still = np.arange(4), np.zeros((4, len(position)))
    time, s = number * period, np.zeros(4)
    samples = Setpoints(time, still + position, still, still, still, number, s)
    return Chunk(samples, samples[:0], Wait.END)


@cache
def warm_machine(machine: str, period: float) -> None:
    """Load the kernels of the machine: play setpoints of axes at rest, without the clock."""
    loaded = Machine.load(machine)
    stands = np.zeros(len(loaded.axis_names))
    endless = np.tile([-np.inf, np.inf], (len(stands), 1))
    drives = SimulatedDrives(loaded, period, stands)
    playback = Playback(loaded.having(travel=endless), period, drives, 1)
    chunk = resting_chunk(stands, period)
    playback.switch_on()
    playback.begin_plan(RunId('warm'))
    playback.push(chunk)
    playback.step()
    for _ in range(3):
        playback.cycle.step()
    playback.read()


def warm_shared() -> None:
    """Load the kernels that several nodes use; called in the process that forks the nodes."""
    settings = Settings()
    read_text(TINY_TEXT, 'warm-up', Transform.of(Machine.load(DEFAULT_MACHINE)), settings)
    warm_kinematics(DEFAULT_MACHINE, settings.interpolation_period)


def compile_feed_and_machine() -> None:
    """Compile kernels that need no kernels of smoothing and kinematics."""
    machine, period = Machine.load(DEFAULT_MACHINE), Settings().interpolation_period
    path = path_without_kernels(machine)
    warm_feed(machine, path, period)
    plan_path(path, machine)
    warm_machine(DEFAULT_MACHINE, period)


def compile_kernels() -> None:
    """Compile all kernels in two processes, except those for HAL, which need a HAL session."""
    beside = get_context('fork').Process(target=compile_feed_and_machine, daemon=True)
    beside.start()
    warm_shared()
    beside.join()
    warm_all(DEFAULT_MACHINE, Settings().interpolation_period)
    warm_machine(DEFAULT_MACHINE, Settings().interpolation_period)


if __name__ == '__main__':
    gc.set_threshold(200_000, 20, 100)  # what numba makes lives on; looking takes a sixth
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))  # so that the process beside ends, too
    compile_kernels()
