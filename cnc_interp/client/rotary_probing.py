"""Find the rotary axes of a running machine by touching one ball at several rotary positions."""

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

import numpy as np
from cnc_interp_msgs.msg import ProbeContact

from cnc_interp.client.operator_client import OperatorClient
from cnc_interp.client.setup_client import SetupClient, connected_setup, work_zero
from cnc_interp.core import DEG, MM, FloatArray, InterpError
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.machine_entries import GEOMETRY
from cnc_interp.machine_model.transform_port import Transform
from cnc_interp.nodes.qos import CONTACTS
from cnc_interp.nodes.seals import hear

STEP, SMALLEST = 1e-5, 1e-9  #: Step of finite differences; largest change at convergence [m].
SEEN = 1e-3  #: A singular value below this share of the largest one is unobservable [-].
LEAST = 4  #: Fewest unknowns of two axes: two for the position of each line.
ROUNDS = 20


@dataclass(frozen=True)
class RotaryCentres:
    machine: Machine  #: Machine with the fitted offsets.
    spread: FloatArray  #: (5, 3): Standard deviation of ``offsets`` and ``tool_offset`` [m].
    ball: FloatArray  #: (3,): Centre of the ball in W [m].
    residuals: FloatArray  #: (n,): Residual of each touch [m].

    def text(self) -> str:
        offsets = np.concatenate([self.machine.offsets, self.machine.tool_offset])
        return '\n'.join(
            f'{key}: [{", ".join(f"{x / MM:.4f}" for x in row)}]  # +- '
            + ', '.join(f'{x / MM:.4f}' for x in spread)
            for key, row, spread in zip(GEOMETRY, offsets, self.spread, strict=True)
            if spread.max() > SMALLEST
        )


def centres_of(machine: Machine, q: FloatArray, beyond: float) -> FloatArray:
    tip, axis = Transform.of(machine).forward(q)
    return tip - beyond * axis


def ball_of(machine: Machine, q: FloatArray, reach: float, beyond: float) -> FloatArray:
    c = centres_of(machine, q, beyond)
    b = c[0] - [0.0, 0.0, reach]
    for _ in range(ROUNDS):
        ways = c - b
        lengths = np.linalg.norm(ways, axis=1)
        step = np.linalg.lstsq(ways / lengths[:, None], lengths - reach, rcond=None)[0]
        b = b + step
    return np.asarray(b)


def fit_rotary_centres(
    machine: Machine, q: FloatArray, reach: float, beyond: float
) -> RotaryCentres:
    """Return the offsets of a machine that fit the touches of a ball best.

    ``q`` (n, n_axes): axis positions at the contacts [m, rad]; ``reach``: radius of the ball plus
    radius of the probe's ball [m]; ``beyond``: how far the centre of the probe's ball lies beyond
    the tip in the machine file [m]. Raises InterpError if the touches do not determine the axes.
    """
    if not machine.has_rotary:
        raise InterpError('the machine has no rotary axes')
    offsets = np.concatenate([machine.offsets, machine.tool_offset])
    ball, pretravel = ball_of(machine, q[:5], reach, beyond), 0.0
    # The workpiece offset only shifts W, and arms of the tool are those of heads.
    free = np.repeat([False, True, True, *[bool(any(machine.rotary_on_head))] * 2], 3)

    def gaps(offsets: FloatArray, ball: FloatArray) -> FloatArray:
        changed = replace(machine, offsets=offsets[:3], tool_offset=offsets[3:])
        ways = centres_of(changed, q, beyond) - ball
        return np.asarray(np.linalg.norm(ways, axis=1) - reach)

    for _ in range(ROUNDS):
        gap = gaps(offsets, ball) - pretravel
        slope = np.zeros((len(q), 15))
        for k in np.flatnonzero(free):
            moved = offsets.copy()
            moved.ravel()[k] += STEP
            slope[:, k] = (gaps(moved, ball) - pretravel - gap) / STEP
        beside = [(gaps(offsets, ball + way) - pretravel - gap) / STEP for way in STEP * np.eye(3)]
        others = np.stack([*beside, np.full(len(q), -1.0)], axis=1)
        # Deviations that the ball and the pretravel can explain are left to them.
        own = slope - others @ np.linalg.lstsq(others, slope, rcond=None)[0]
        inverse = np.linalg.pinv(own, rcond=SEEN)
        change = -inverse @ gap
        rest = -np.linalg.lstsq(others, gap + slope @ change, rcond=None)[0]
        offsets += change.reshape(5, 3)
        ball, pretravel = ball + rest[:3], pretravel + rest[3]
        if np.abs(change).max() < SMALLEST:
            break
    seen = int(np.linalg.matrix_rank(inverse, tol=0.0 if not inverse.any() else None))
    left = gaps(offsets, ball) - pretravel
    if seen < LEAST or len(q) <= seen + 4:
        raise InterpError('the touches do not determine both rotary axes; turn the axes further')
    noise = np.sqrt(left @ left / (len(q) - seen - 4))
    spread = noise * np.linalg.norm(inverse, axis=1).reshape(5, 3)
    found = replace(machine, offsets=offsets[:3], tool_offset=offsets[3:])
    return RotaryCentres(found, spread, ball, left)


#: Index of the slow touch among the answers to a ``probe_touch``, and number of answers.
SLOW, ANSWERS = 2, 4
PATIENCE = 2.0  #: Longest wait for a contact message after its line [s].
UPRIGHT = 1e-6  #: Tolerance of the upright tool axis at the start [-].


@dataclass(frozen=True)
class BallProbing:
    """Dimensions of ball and probe, and parameters of the touches; SI units except feeds."""

    ball: float  #: Diameter of the ball on the machine.
    tip: float  #: Diameter of the probe's ball.
    longer: float  #: Distance of the probe's end beyond the tip of the machine file.
    beside: float  #: Gap between the two balls before a touch.
    feed: float  #: Feeds of the first and of the second touch [mm/min].
    slow: float
    primary: Sequence[float]  #: Positions of each rotary axis [rad].
    secondary: Sequence[float]

    @property
    def reach(self) -> float:
        return (self.ball + self.tip) / 2

    @property
    def beyond(self) -> float:
        """How far the centre of the probe's ball lies beyond the tip in the machine file [m]."""
        return self.longer - self.tip / 2

    def poses(self) -> Iterator[tuple[float, float]]:
        yield from product(self.primary, self.secondary)


class _Toucher:
    def __init__(self, client: OperatorClient, setup: SetupClient, machine: Machine):
        self._client, self._setup, self._machine = client, setup, machine
        self._contacts: list[ProbeContact] = []
        self.touched: list[FloatArray] = []

    def hear(self, contact: ProbeContact) -> None:
        self._contacts.append(contact)

    def give(self, line: str) -> None:
        """Execute an MDI line; raise InterpError if it fails."""
        answer = self._client.wait_for(self._client.give_line(line))
        if not answer.ok:
            raise InterpError(f'{line}: {answer.message}')

    def place(self, tip: FloatArray) -> list[float]:
        """Return a point, given in W [m], in program coordinates [mm]."""
        table = self._setup.table
        assert table is not None
        zero, turn = work_zero(table, self._setup.setup, self._setup.setup.offset)
        if turn:
            raise InterpError('the active work offset is rotated; use an offset without rotation')
        return list(np.round((tip - zero) / MM, 6))

    def touch(self, line: str) -> None:
        """Execute a line that touches twice; store the axis positions at the second touch."""
        before = len(self._contacts)
        self.give(line)
        until = time.monotonic() + PATIENCE
        while len(self._contacts) < before + ANSWERS and time.monotonic() < until:
            self._client.serve()
        if len(self._contacts) != before + ANSWERS:
            raise InterpError(f'{line}: the positions of the probe did not arrive; try again')
        self.touched.append(np.array(self._contacts[before + SLOW].positions))


def _words(letters: Sequence[str], values: Sequence[float]) -> str:
    return ' '.join(f'{letter}{value:.6f}' for letter, value in zip(letters, values, strict=True))


def _call(name: str, *values: float) -> str:
    return f'O<{name}> CALL ' + ' '.join(f'[{value:.6f}]' for value in values)


def probe_rotary_centres(
    wanted: BallProbing, namespace: str, domain: int | None, told: Callable[[str], None]
) -> tuple[RotaryCentres, str]:
    """Touch the ball at all rotary positions; return fitted geometry and name of the machine.

    At the start the probe must be upright above the ball, at most four times ``beside`` from it.
    Raises InterpError if a touch fails, or if the touches do not determine the axes.
    """
    with connected_setup('probe', namespace, domain) as (client, setup, machine):
        toucher = _Toucher(client, setup, machine)
        ear = hear(client.node, ProbeContact, 'probe_contact', toucher.hear, CONTACTS)
        until = time.monotonic() + PATIENCE
        while not ear.subscription.get_publisher_count() and time.monotonic() < until:
            client.serve()
        _touch_all(toucher, wanted, machine, client.state, told)
        fit = fit_rotary_centres(machine, np.array(toucher.touched), wanted.reach, wanted.beyond)
        return fit, client.machine


def _touch_all(
    toucher: _Toucher,
    wanted: BallProbing,
    machine: Machine,
    state: Any,
    told: Callable[[str], None],
) -> None:
    transform, names = Transform.of(machine), machine.axis_names[3:5]
    tip, axis = transform.forward(np.array([state.commanded_positions]))
    if not machine.has_rotary or axis[0, 2] < 1.0 - UPRIGHT:
        raise InterpError('first move the probe above the ball, with the rotary axes at zero')
    way, reach = wanted.beside, wanted.reach
    for line in (
        'G21 G90 G94 M428',
        f'#<_probe_feed>={wanted.feed:g}',
        f'#<_probe_slow>={wanted.slow:g}',
    ):
        toucher.give(line)
    toucher.touch(_call('probe_touch', 0, 0, -1, 4 * way / MM))
    ball = transform.forward(toucher.touched[0][None])[0][0] - [0, 0, wanted.beyond + reach]
    toucher.give('G0 ' + _words('XYZ', toucher.place(tip[0])))
    poses = [(0.0, 0.0), *wanted.poses()]
    for k, pose in enumerate(poses):
        told(f'pose {k + 1} of {len(poses)}')
        o = transform.tool_axis(np.array([pose]))[0]
        u = np.cross(o, [0.0, 1.0, 0.0] if abs(o[1]) < 0.9 else [1.0, 0.0, 0.0])
        u /= np.linalg.norm(u)
        v = np.cross(o, u)
        above = ball + (wanted.beyond + reach + way) * o
        rotary = _words(names, [angle / DEG for angle in pose])
        toucher.give(f'G0 {_words("XYZ", toucher.place(above))} {rotary}')
        if k:
            toucher.touch(_call('probe_touch', *-o, 2 * way / MM))
            toucher.give('G0 ' + _words('XYZ', toucher.place(above)))
        sign = -1.0 if k % 2 else 1.0
        for side in (u, -u, v, -v) if k == 0 else (sign * u, sign * v):
            free = above + (reach + way) * side
            down = -(reach + way) * o / MM
            toucher.touch(_call('probe_beside', *toucher.place(free), *down, *-side, 2 * way / MM))
        toucher.give('G0 ' + _words('XYZ', toucher.place(above)))
        if k == 0:
            ball = ball_of(machine, np.array(toucher.touched), reach, wanted.beyond)
