"""Identify the model of a drive: a program that excites it, and a least-squares fit.

The program moves one axis after the other. Moves back and forth at several speeds show friction,
backlash and lags. Then the axis moves in one direction while its feed alternates faster and faster
(a chirp), which shows the loops and the flexible mode, because the axis never sticks. Jerk-limited
reversals come last. The planner keeps the program within limits and travel, as any other program.

The loops have the transfer function (f s + kv) / (tau s^2 + (1 + tau B) s + kv). Positions
determine only the three ratios of its coefficients, so viscous friction B is taken from the
machine file; kv, f and tau follow. Forces are determined only relative to the inertia, which is
also taken from the file. Without an inertia, an axis is fitted without friction.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from cnc_interp.core import DEG, MINUTE, MM, BoolArray, FloatArray, InterpError, MachineError
from cnc_interp.core.axis_limits import DriveLoad
from cnc_interp.drives.drive_model import axis_words, follow_all, place, room_of_delay
from cnc_interp.machine_model import axis_drives
from cnc_interp.machine_model.axis_drives import AxisDrive
from cnc_interp.machine_model.machine import Axis, Machine

STILL = 1e-8  #: A setpoint step below this is rest [m, rad].
SETTLING = 0.3  #: Time after the last motion of an axis that the fit still uses [s].
FORGOTTEN = 2  #: Number of reversals until the motion before the recording no longer matters.
MODES = (22.0, 32.0, 45.0, 65.0)  #: Frequencies at which the search for the mode begins [Hz].
SEARCH, LAST = 6, 60  #: Most steps of the first searches, and of the last one.
GAIN = 1e-4  #: The search ends if the sum of squares falls by less than this share [-].
WHOLE = 0.98  #: Least share of positions at whole steps of a measuring system [-].
CORRELATED = 0.1  #: Errors farther apart in time are uncorrelated, unless at the same place [s].
SIGMAS = 1.96  #: Half of the two-sided 95 % interval, in standard deviations.


@dataclass(frozen=True)
class Parameter:
    name: str  #: Field of ``AxisDrive``, or ``coulomb``.
    start: float  #: Start of the search; for rotary axes in rad instead of m.
    low: float
    high: float


#: Fitted values in SI; friction is divided by the inertia.
LOOPS = (
    Parameter('position_gain', 50.0, 3.0, 900.0),
    Parameter('feed_forward', 0.95, 0.0, 1.2),
    Parameter('time_constant', 4e-3, 2e-4, 0.09),
    Parameter('delay', 1e-3, 0.0, 0.03),
)
MECHANICS = (
    Parameter('backlash', 5e-6, 0.0, 2e-3),
    Parameter('mode_frequency', 40.0, 8.0, 300.0),
    Parameter('mode_damping', 0.05, 1e-3, 0.9),
)
FRICTION = (
    Parameter('coulomb', 0.2, 0.0, 50.0),
    Parameter('static', 0.1, 0.0, 50.0),  # excess over Coulomb friction
    Parameter('stribeck_velocity', 2e-3, 1e-4, 0.5),
)


@dataclass(frozen=True)
class IdentifiedAxis:
    axis: int  #: The axis.
    drive: AxisDrive  #: Its model.
    load: DriveLoad | None  #: Inertia and friction.
    half_width: Mapping[str, float]  #: Half of the 95 % intervals, by field [SI].
    rows: FloatArray  #: (K,): Rows of the recording that were fitted.
    #: (K,): Positions [m or rad].
    setpoint: FloatArray
    measured: FloatArray
    modelled: FloatArray


def identify_axis(
    machine: Machine,
    axis: int,
    period: float,
    setpoints: FloatArray,
    rates: FloatArray,
    feedback: FloatArray,
) -> IdentifiedAxis | None:
    """Fit the model of one axis; None if it did not move.

    ``setpoints``, their ``rates``, measured ``feedback``: (K, n_axes) [m, rad, per s].
    Raises InterpError if the axis reversed too seldom to show its friction and backlash.
    """
    rows = _moving(setpoints[:, axis], period)
    if not len(rows):
        return None
    r, f, y = (np.ascontiguousarray(each[rows, axis]) for each in (setpoints, rates, feedback))
    counts = _after_reversals(r) & _near_motion(r, period)
    if not counts.any():
        raise InterpError(
            f'{machine.axis_names[axis]} reversed less than {FORGOTTEN + 1} times; record the '
            'program of cnc-interp excite'
        )
    fit = _Fit(period, r, f, y, counts, machine.limits.axes[axis].load)
    drive, load, half_width = fit.solve()
    drive = replace(drive, resolution=resolution_of(y))
    return IdentifiedAxis(
        axis,
        drive,
        load,
        half_width,
        rows[counts],
        r[counts],
        y[counts],
        fit.answer(drive, load)[counts],
    )


def resolution_of(positions: FloatArray) -> float:
    """Return the step of the measuring system; 0 if positions are not multiples of a step."""
    steps = np.diff(np.unique(positions))
    steps = steps[steps > 1e-12]
    if len(steps) < 10:
        return 0.0
    step = float(np.median(steps[steps < 1.5 * steps.min()]))
    off = np.abs(positions / step - np.round(positions / step))
    return step if np.mean(off < 0.05) > WHOLE else 0.0


def _moving(setpoint: FloatArray, period: float) -> FloatArray:
    moves = np.flatnonzero(np.abs(np.diff(setpoint)) > STILL)
    if not len(moves):
        return np.zeros(0, dtype=int)
    return np.arange(moves[0], min(moves[-1] + 2 + round(SETTLING / period), len(setpoint)))


def _after_reversals(setpoint: FloatArray) -> BoolArray:
    steps = np.diff(setpoint, prepend=setpoint[0])
    moves = np.flatnonzero(np.abs(steps) > STILL)
    turns = moves[1:][np.sign(steps[moves[1:]]) != np.sign(steps[moves[:-1]])]
    counts = np.zeros(len(setpoint), dtype=np.bool_)
    if len(turns) > FORGOTTEN:
        counts[turns[FORGOTTEN] :] = True
    return counts


def _near_motion(setpoint: FloatArray, period: float) -> BoolArray:
    """Return True where the axis moves or settles; a long rest only repeats one rounding error."""
    moves = np.abs(np.diff(setpoint, prepend=setpoint[0])) > STILL
    last = np.maximum.accumulate(np.where(moves, np.arange(len(moves)), -len(moves)))
    return np.arange(len(moves)) - last <= SETTLING / period


def spreads_of(
    jacobian: FloatArray, residual: FloatArray, place: FloatArray, lags: int
) -> FloatArray:
    """Return the standard deviations of numbers fitted by least squares, shape (k,).

    With J = Q R and P = R^-1 Q^T the covariance is P S P^T. S has two parts, whose common diagonal
    counts once: errors near in time, by the autocorrelation of the residual; and errors at one
    place. The rounding of a measuring system is the same whenever the axis stands there, and does
    not average out. Places closer together than half the residual count as one. A place with much
    weight pulls the fit towards its errors, so the residual there is too small by I - Q_g Q_g^T;
    the scores correct this (as the jackknife does).
    """
    ortho, triangle = np.linalg.qr(jacobian)
    to_fitted, count = np.linalg.pinv(triangle), len(residual)
    weights = to_fitted @ ortho.T
    size = 1 << (2 * count - 1).bit_length()
    covariance = np.fft.irfft(np.abs(np.fft.rfft(residual, size)) ** 2, size)[:count] / count
    covariance[lags:] = 0.0
    covariance[:lags] *= 1.0 - np.arange(lags) / lags  # so that no variance is negative
    spectrum = np.abs(np.fft.rfft(np.concatenate([covariance, covariance[:0:-1]]), size))
    in_time = [
        row @ np.fft.irfft(np.fft.rfft(row, size) * spectrum, size)[:count] for row in weights
    ]
    width = max(0.5 * float(np.std(residual)), 1e-15)
    cell = np.floor((place - place.min()) / width)
    order = np.argsort(cell, kind='stable')
    first = np.flatnonzero(np.diff(cell[order], prepend=-1.0))
    rows = ortho[order]
    scores = np.add.reduceat(rows * residual[order, None], first)
    leverage = np.add.reduceat(rows[:, :, None] * rows[:, None, :], first)
    left = (1.0 + 1e-9) * np.eye(len(triangle)) - leverage
    scores = np.linalg.solve(left, scores[:, :, None])[:, :, 0]
    in_place = ((scores @ to_fitted.T) ** 2).sum(axis=0) - ((weights * residual) ** 2).sum(axis=1)
    return np.asarray(np.sqrt(np.array(in_time) + np.maximum(in_place, 0.0)))


class _Fit:
    def __init__(
        self,
        period: float,
        setpoint: FloatArray,
        rate: FloatArray,
        measured: FloatArray,
        counts: BoolArray,
        load: DriveLoad | None,
    ):
        self._period, self._counts, self._load = period, counts, load
        self._setpoint, self._rate, self._measured = setpoint, rate, measured
        self._largest = max(each.high for each in LOOPS if each.name == 'delay')

    def answer(self, drive: AxisDrive, load: DriveLoad | None) -> FloatArray:
        words = np.zeros((1, room_of_delay(self._largest, self._period)))
        axis_words(words[0], replace(drive, resolution=0.0), load, self._period)
        place(words[0], float(self._setpoint[0]))
        return follow_all(words, self._setpoint[:, None], self._rate[:, None])[0][:, 0]

    def solve(self) -> tuple[AxisDrive, DriveLoad | None, dict[str, float]]:
        friction = FRICTION if self._load else ()
        every = (*LOOPS, *friction, *MECHANICS)
        loops = (*LOOPS, *friction[:1])
        best = self._search(loops, {each.name: each.start for each in loops}, LAST)[0]
        rest = {each.name: each.start for each in every if each.name not in best}
        found = [
            self._search(every, {**best, **rest, 'mode_frequency': mode}, SEARCH) for mode in MODES
        ]
        best = min(found, key=lambda each: each[1])[0]
        cost = np.inf
        while True:  # friction has corners, at which the search may stop too early
            best, least, jacobian, residual = self._search(every, best, LAST)
            if least > (1.0 - GAIN) * cost:
                break
            cost = least
        drive, load = self._model(best)
        return drive, load, self._widths(every, best, jacobian, residual)

    def _model(self, values: Mapping[str, float]) -> tuple[AxisDrive, DriveLoad | None]:
        named, load = dict(values), self._load
        coulomb, excess = named.pop('coulomb', 0.0), named.pop('static', 0.0)
        if load is not None:
            load = replace(load, coulomb=coulomb * load.inertia)
            named['static'] = (coulomb + excess) * load.inertia if excess else 0.0
        return AxisDrive(**named), load

    def _search(
        self, parameters: tuple[Parameter, ...], start: Mapping[str, float], steps: int
    ) -> tuple[dict[str, float], float, FloatArray, FloatArray]:
        from scipy.optimize import least_squares

        scale = np.array([each.start for each in parameters])
        low, high = (
            np.array([getattr(each, end) for each in parameters]) / scale
            for end in ('low', 'high')
        )
        names = [each.name for each in parameters]
        spread = float(np.std(self._measured - self._setpoint)) or 1.0

        def residual(values: FloatArray) -> FloatArray:
            model = self._model(dict(zip(names, (values * scale).tolist(), strict=True)))
            off = (self.answer(*model) - self._measured)[self._counts]
            return np.asarray(off / spread)

        first = np.clip([start[name] for name in names] / scale, low + 1e-6, high - 1e-6)
        done = least_squares(
            residual,
            first,
            bounds=(low, high),
            max_nfev=steps,
            x_scale='jac',
            diff_step=1e-4,
            ftol=1e-11,
        )
        values = dict(zip(names, (done.x * scale).tolist(), strict=True))
        jacobian: FloatArray = done.jac * spread / scale
        return values, float(done.cost), jacobian, done.fun * spread

    def _widths(
        self,
        parameters: tuple[Parameter, ...],
        values: Mapping[str, float],
        jacobian: FloatArray,
        residual: FloatArray,
    ) -> dict[str, float]:
        """Return half widths of 95 % intervals: ``SIGMAS`` times the standard deviations."""
        place = self.answer(*self._model(values))[self._counts]
        lags = min(len(residual) - 1, round(CORRELATED / self._period))
        spreads = SIGMAS * spreads_of(jacobian, residual, place, lags)
        names = (each.name for each in parameters)
        widths = dict(zip(names, spreads.tolist(), strict=True))
        if self._load is not None:
            inertia = self._load.inertia
            both = np.hypot(widths['coulomb'], widths['static'])
            widths['coulomb'] *= inertia
            widths['static'] = float(both) * inertia
        return widths


SECTIONS = ('loads', 'drives')


def with_drives(
    text: str,
    machine: Machine,
    drives: Mapping[int, AxisDrive],
    loads: Mapping[int, DriveLoad],
    half_widths: Mapping[int, Mapping[str, float]],
    origin: str,
) -> str:
    """Write drives, loads and half of the 95 % intervals [SI] into the text of a machine file."""
    parts = [_without_sections(text).rstrip('\n'), '']
    if loads:
        parts += ['# Inertia, torque and friction of the axes.', 'loads:']
        for j, load in sorted(loads.items()):
            keys = axis_drives.LINEAR_KEYS if machine.is_linear[j] else axis_drives.ROTARY_KEYS
            values = zip(keys, vars(load).values(), strict=True)
            row = [f'{key}: {value:.6g}' for key, value in values]
            parts.append(f'  {machine.axis_names[j]}: {{{", ".join(row)}}}')
            width = half_widths.get(j, {}).get('coulomb')
            if width is not None:
                parts.append(f'  #  +- 95 %: {keys[2]}: {width:.2g}')
        parts.append('')
    parts += [f'# How they follow their setpoints, identified from {origin}.', 'drives:']
    for j, drive in sorted(drives.items()):
        linear, row, widths = bool(machine.is_linear[j]), [], []
        for entry in axis_drives.ENTRIES:
            key, unit = axis_drives.key_and_unit(entry, linear)
            value = getattr(drive, entry.field)
            if value or entry.field == 'feed_forward':
                row.append(f'{key}: {value / unit:.6g}')
            if entry.field in half_widths.get(j, {}):
                widths.append(f'{key}: {half_widths[j][entry.field] / unit:.2g}')
        parts.append(f'  {machine.axis_names[j]}: {{{", ".join(row)}}}')
        if widths:
            parts.append(f'  #  +- 95 %: {", ".join(widths)}')
    return '\n'.join([*parts, ''])


def _without_sections(text: str) -> str:
    kept: list[str] = []
    inside = False
    for line in text.splitlines():
        if line.split(':')[0] in SECTIONS:
            inside = True
            while kept and kept[-1].startswith('#'):
                kept.pop()
        elif inside and line and not line[0].isspace() and not line.startswith('#'):
            inside = False
        if not inside:
            kept.append(line)
    return '\n'.join(kept)


#: Largest feed of the program, as a share of the axis' velocity, and the least one of the sweep.
FASTEST, SLOWEST = 0.2, 0.0005
SPEEDS = 7
SPEED_HELD = 0.3  #: Time at a constant speed [s].
#: Half periods of the chirp [s], their number, and the lower feed over the higher one.
LONGEST_HALF, SHORTEST_HALF, HALVES, DIP = 0.12, 0.007, 50, 0.4
ROOM = 0.4  #: Largest motion to one side, as a share of the travel.


def excitation(machine: Machine) -> str:
    """Return a program for all axes that ends where it begins; MachineError if travel is short."""
    lines = [f'(EXCITATION OF THE AXES OF {machine.name.upper()}: for cnc-interp identify)']
    moving = [axis for axis in machine.axes if not axis.locked]
    lines += ['G21 G94 G91', 'TRAFOOF', 'G0 ' + ' '.join(f'{axis.name}0' for axis in moving)]
    for axis in moving:
        unit = MM if axis.linear else DEG
        lines.append(f'({axis.name})')
        for way, speed in _moves(axis):
            lines.append(f'G1 {axis.name}{way / unit:.5f} F{speed / unit * MINUTE:.4f}')
    return '\n'.join([*lines, 'M30', ''])


def _moves(axis: Axis) -> Iterator[tuple[float, float]]:
    """Yield distance [m or rad] and speed of each move; the distances add up to zero."""
    v, a, j = axis.max_velocity, axis.max_acceleration, axis.max_jerk
    room = ROOM * min(abs(axis.travel[0]), abs(axis.travel[1]))
    if not room > 0.0:
        raise MachineError('is at the end of its travel; move it to the middle', axis.name)

    def length(speed: float) -> float:
        ramp = max(speed / a + a / j, 2.0 * np.sqrt(speed / j))
        return float(min(speed * (SPEED_HELD + ramp), room))

    fastest = min(FASTEST * v, 0.2 * a)
    for speed in (0.1 * fastest, 0.1 * fastest):  # the motion before is forgotten
        yield length(speed), speed
        yield -length(speed), speed
    for speed in np.geomspace(fastest, SLOWEST * v, SPEEDS):
        yield length(speed), speed
        yield -length(speed), speed
    # Half periods t at speeds V and DIP V alternately: the mean speed stays.
    high = 0.25 * fastest
    times = np.geomspace(LONGEST_HALF, SHORTEST_HALF, HALVES)
    for sign in (1.0, -1.0):
        for k, time in enumerate(times):
            speed = high * (DIP if k % 2 else 1.0)
            yield sign * speed * time, speed
    for way in np.geomspace(length(fastest), 20e-6 if axis.linear else 2e-4, 10):
        yield way, fastest
        yield -way, fastest
