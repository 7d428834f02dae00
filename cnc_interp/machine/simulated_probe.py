"""A simulated probe: a ball that touches given surfaces, for drives with a compiled step.

The file is in mm and deg, in the workpiece frame of the machine file:

    probe: {radius_mm: 1.5, noise_um: 1.0, delay_ms: 1.0}
    surfaces:
      - {plane: [0, 0, 0], normal: [0, 0, 1]}
      - {bore: [20, 0, 0], radius_mm: 10}     # along Z, below its centre
      - {boss: [60, 0, 0], radius_mm: 10}
      - {ball: [0, 0, 30], radius_mm: 12}
      - {box: [0, 40, -5], half: [30, 10, 5], turned_deg: 3}
    machine: real.yaml                        # true geometry of the axes, if different

The ball touches a surface when the signed distance of its centre is its radius. Near an edge, the
distance is that from the planes that meet there.
"""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numba import carray, types

from cnc_interp.core import DEG, MM, FloatArray, InterpError
from cnc_interp.core.kernels import cfunc, njit
from cnc_interp.core.native import call_drives, pointer
from cnc_interp.core.small_files import UnreadableError, read_yaml
from cnc_interp.machine.simulated_drives import SimulatedDrives
from cnc_interp.machine_model.error_map import displacement
from cnc_interp.machine_model.five_axis_kernels import SIZE, forward
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.signals import SINCE as STAMPED
from cnc_interp.machine_model.transform_port import Transform

PLANE, BALL, BORE, BOSS, BOX = range(5)
KINDS = {'plane': PLANE, 'ball': BALL, 'bore': BORE, 'boss': BOSS, 'box': BOX}
#: Further entries of each kind of surface, with their defaults.
GIVEN: Mapping[int, Mapping[str, Any]] = {
    PLANE: {'normal': [0.0, 0.0, 1.0]},
    BALL: {'radius_mm': None},
    BORE: {'radius_mm': None},
    BOSS: {'radius_mm': None},
    BOX: {'half': None, 'turned_deg': 0.0},
}
PROBE = {'radius_mm': 1.5, 'length_mm': 0.0, 'noise_um': 0.0, 'delay_ms': 0.0}
COLUMNS = 8  #: Of a surface: kind, place, normal or half sizes, radius or angle.
#: Integer words of the memory: addresses of step and memory of the drives, of the input, surfaces,
#: geometry and noise, and their numbers; periods of delay, and since the last change; address of
#: the input for the time stamp, or 0; address and number of the errors.
STEP, MEMORY, INPUT, SURFACES, COUNT, GEOMETRY, EXTRA, NOISE, AT, DELAY, SINCE = range(11)
STAMP, ERRORS, ERRORS_SIZE, WORDS = range(11, 15)
#: Numbers after them: radius of the ball, and its centre beyond the tip of the machine file [m];
#: its gap a period before [m], the share of a period since the contact, the period [s].
RADIUS, BEYOND, GAP, PART, PERIOD, SIZE_OF_MEMORY = range(WORDS, WORDS + 6)
TOUCHES = 1024  #: Touches after which the noise repeats.


@njit(cache=True, nogil=True)
def distance(surface: FloatArray, p: FloatArray) -> float:
    """Return the signed distance of a point from a surface, (COLUMNS,) [m]; negative inside."""
    kind, radius = surface[0], surface[7]
    x, y, z = p[0] - surface[1], p[1] - surface[2], p[2] - surface[3]
    if kind == PLANE:
        return float(x * surface[4] + y * surface[5] + z * surface[6])
    if kind == BALL:
        return float(math.sqrt(x * x + y * y + z * z) - radius)
    if kind == BORE:
        return float(max(z, radius - math.hypot(x, y)))
    if kind == BOSS:
        return float(max(z, math.hypot(x, y) - radius))
    c, s = math.cos(radius), math.sin(radius)
    x, y = abs(c * x + s * y) - surface[4], abs(c * y - s * x) - surface[5]
    return float(max(x, y, abs(z) - surface[6]))


@cfunc(types.int64(*[types.uintp] * 3, types.int64), cache=True)
def probe_once(memory: int, setpoint: int, feedback: int, n: int) -> int:
    """Step the drives, then set the probe input; see ``drives.CycleDrives``."""
    numbers = carray(pointer(memory), (SIZE_OF_MEMORY,))
    head = numbers.view(np.int64)
    fault = call_drives(np.uintp(head[STEP]), np.uintp(head[MEMORY]), setpoint, feedback, n)
    extra = head[EXTRA]
    geometry = carray(pointer(np.uintp(head[GEOMETRY])), (SIZE + 3 * extra,))
    actual = carray(pointer(feedback), (n,))
    q = np.zeros((1, 5))
    for i in range(n - extra):
        q[0, i] = actual[i]
    for k in range(extra):
        for i in range(3):
            q[0, i] += actual[n - extra + k] * geometry[SIZE + 3 * k + i]
    if head[ERRORS_SIZE] > 0:
        errors = carray(pointer(np.uintp(head[ERRORS])), (head[ERRORS_SIZE],))
        jets = np.zeros((4, 5 + extra))
        for i in range(n - extra):
            jets[0, i] = actual[i]
        for k in range(extra):
            jets[0, 5 + k] = actual[n - extra + k]
        q[0, :3] += displacement(errors, geometry, jets)[0]
    tip, axis = forward(geometry, q)
    centre = tip[0] - numbers[BEYOND] * axis[0]
    nearest = np.inf
    for row in carray(pointer(np.uintp(head[SURFACES])), (head[COUNT], COLUMNS)):
        nearest = min(nearest, distance(row, centre))
    noise = carray(pointer(np.uintp(head[NOISE])), (TOUCHES,))[head[AT] % TOUCHES]
    told = carray(pointer(np.uintp(head[INPUT])), (1,))
    gap, before = nearest - numbers[RADIUS] - noise, numbers[GAP]
    touches, numbers[GAP] = 1.0 if gap <= 0.0 else 0.0, gap
    if touches == told[0]:
        head[SINCE] = 0
    else:
        if head[SINCE] == 0:
            numbers[PART] = gap / (gap - before) if gap * before < 0.0 else 0.0
        head[SINCE] += 1
        if head[SINCE] > head[DELAY]:
            told[0], head[SINCE] = touches, 0
            if head[STAMP]:
                stamp = carray(pointer(np.uintp(head[STAMP])), (1,))
                stamp[0] = numbers[PART] * numbers[PERIOD]
            head[AT] += 1
    return int(fault)


class ProbingDrives(SimulatedDrives):
    """Simulated drives whose input ``probe`` is on while the ball touches a surface of a file."""

    def __init__(self, machine: Machine, period: float, position: FloatArray, file: Path):
        super().__init__(machine, period, position)
        if machine.signals.probe is None:
            raise InterpError('probe_touches: the machine file has no probe among its signals')
        probe, self._surfaces, real = read_surfaces(file)
        deviates = np.random.default_rng(1).standard_normal(TOUCHES)
        self._noise = deviates * probe['noise_um'] * 1e-6
        true = Transform.of(Machine.load(real) if real else machine)
        self._geometry, self._errors = true.packed, true.errors.packed
        self._inner = self.step, self.memory
        place = machine.signals.probe[1]
        self.memory = np.zeros(SIZE_OF_MEMORY)
        head = self.memory.view(np.int64)
        head[[STEP, MEMORY]] = self._inner[0], self._inner[1].ctypes.data
        head[INPUT] = self.inputs[place:].ctypes.data
        head[[SURFACES, COUNT]] = self._surfaces.ctypes.data, len(self._surfaces)
        head[GEOMETRY], head[EXTRA] = self._geometry.ctypes.data, len(machine.extra_names)
        head[ERRORS], head[ERRORS_SIZE] = self._errors.ctypes.data, len(self._errors)
        head[NOISE], head[DELAY] = self._noise.ctypes.data, round(probe['delay_ms'] / 1e3 / period)
        if (stamp := machine.signals.input(STAMPED)) >= 0:
            head[STAMP] = self.inputs[stamp:].ctypes.data
        radius, self.memory[PERIOD] = probe['radius_mm'] * MM, period
        self.memory[RADIUS], self.memory[BEYOND] = radius, probe['length_mm'] * MM - radius
        self.step = int(probe_once.address)


def read_surfaces(file: Path) -> tuple[dict[str, float], FloatArray, str]:
    """Read the ball, the surfaces, (n, COLUMNS), and the machine; InterpError if invalid."""
    try:
        content = read_yaml(file)
    except (OSError, UnreadableError) as problem:
        raise InterpError(f'{file}: cannot be read: {problem}') from None
    if not isinstance(content, dict) or set(content) - {'probe', 'surfaces', 'machine'}:
        raise InterpError(f'{file}: may hold probe, surfaces and machine')
    probe = _numbers(content.get('probe') or {}, PROBE, f'{file}: probe')
    rows = []
    for k, given in enumerate(content.get('surfaces') or [], start=1):
        where = f'{file}: surface {k}'
        names = set(given) & set(KINDS) if isinstance(given, dict) else set()
        if len(names) != 1:
            raise InterpError(f'{where}: is one of {", ".join(KINDS)}')
        name = names.pop()
        kind = KINDS[name]
        found = _numbers(given, {name: None, **GIVEN[kind]}, where)
        shape = np.array(found.get('normal', found.get('half', [0.0] * 3)), dtype=float)
        if kind == PLANE:
            shape /= np.linalg.norm(shape)
        elif kind == BOX:
            shape *= MM
        last = found.get('radius_mm', 0.0) * MM + found.get('turned_deg', 0.0) * DEG
        rows.append([kind, *np.array(found[name]) * MM, *shape, last])
    real = str(content.get('machine') or '')
    return probe, np.array(rows, dtype=float).reshape(-1, COLUMNS), real


def _numbers(given: Any, known: Mapping[str, Any], where: str) -> dict[str, Any]:
    """Return the numbers of a mapping; places and directions have three each."""
    if not isinstance(given, dict) or set(given) - set(known):
        raise InterpError(f'{where}: may have {", ".join(known)}')
    found = {**known, **given}
    for name, value in found.items():
        single = name.endswith(('_mm', '_um', '_ms', '_deg'))
        values = np.array([value] if single else value, dtype=object).ravel().tolist()
        sound = all(isinstance(v, int | float) and math.isfinite(v) for v in values)
        if (
            not sound
            or len(values) != (1 if single else 3)
            or (name == 'normal' and not any(values))
        ):
            raise InterpError(f'{where}: {name} must be {"a number" if single else "[x, y, z]"}')
    return found
