"""Touch one ball at several rotary positions of a running machine, and find its rotary axes."""

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
from cnc_interp_msgs.msg import ProbeContact

from cnc_interp.client.hand_move import connected
from cnc_interp.client.operator_client import OperatorClient
from cnc_interp.client.setup_client import SetupClient, work_zero
from cnc_interp.core import DEG, MM, FloatArray, InterpError
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.rotary_centres import RotaryCentres, ball_of, fit_rotary_centres
from cnc_interp.machine_model.transform import Transform
from cnc_interp.nodes.qos import CONTACTS

SLOW, ANSWERS = 2, 4  #: The slow touch among the answers of the probe in ``probe_touch``.
PATIENCE = 2.0  #: An answer of the probe comes so long after its line, at the latest [s].
UPRIGHT = 1e-6  #: The tool axis stands upright at the start within this [-].


@dataclass(frozen=True)
class BallProbing:
    """The ball, the probe, and how it is touched; SI units."""

    ball: float  #: Diameter of the ball on the machine.
    tip: float  #: Diameter of the probe's ball.
    longer: float  #: Length of the probe beyond the tip in the machine file.
    beside: float  #: Way between both balls before a touch.
    feed: float  #: Feeds of the first and of the second touch [mm/min].
    slow: float
    primary: Sequence[float]  #: Positions of the rotary axes [rad].
    secondary: Sequence[float]

    @property
    def reach(self) -> float:
        return (self.ball + self.tip) / 2

    @property
    def beyond(self) -> float:
        """Centre of the probe's ball beyond the tip in the machine file [m]."""
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
        """Have a line executed; InterpError if that fails."""
        answer = self._client.wait_for(self._client.give_line(line))
        if not answer.ok:
            raise InterpError(f'{line}: {answer.message}')

    def place(self, tip: FloatArray) -> list[float]:
        """Return a point of W in program coordinates [mm]."""
        table = self._setup.table
        assert table is not None
        zero, turn = work_zero(table, self._setup.setup, self._setup.setup.offset)
        if turn:
            raise InterpError('the active work offset is turned; use one that is not')
        return list(np.round((tip - zero) / MM, 6))

    def touch(self, line: str) -> None:
        """Have a line with one double touch executed, and keep the place of the second one."""
        before = len(self._contacts)
        self.give(line)
        until = time.monotonic() + PATIENCE
        while len(self._contacts) < before + ANSWERS and time.monotonic() < until:
            self._client.serve()
        if len(self._contacts) != before + ANSWERS:
            raise InterpError(f'{line}: the places of the probe did not arrive; try again')
        self.touched.append(np.array(self._contacts[before + SLOW].positions))


def _words(letters: Sequence[str], values: Sequence[float]) -> str:
    return ' '.join(f'{letter}{value:.6f}' for letter, value in zip(letters, values, strict=True))


def _call(name: str, *values: float) -> str:
    return f'O<{name}> CALL ' + ' '.join(f'[{value:.6f}]' for value in values)


def probe_rotary_centres(
    wanted: BallProbing, namespace: str, domain: int | None, told: Callable[[str], None]
) -> tuple[RotaryCentres, str]:
    """Touch the ball at all poses; return the geometry that fits, and the machine as it is named.

    The probe stands upright above the ball, not farther from it than four times ``beside``. Raises
    InterpError if a touch fails, or the touches do not determine the axes.
    """
    found: list[SetupClient] = []

    def ready(client: OperatorClient) -> bool:
        if not found:
            found.append(SetupClient(client, 'cnc-interp'))
        return found[0].table is not None and not client.silent

    with connected('probe', namespace, domain, ready) as (client, machine):
        toucher = _Toucher(client, found[0], machine)
        node = client.node
        heard = node.create_subscription(ProbeContact, 'probe_contact', toucher.hear, CONTACTS)
        until = time.monotonic() + PATIENCE
        while not heard.get_publisher_count() and time.monotonic() < until:
            client.serve()
        _touch_all(toucher, wanted, machine, client.state, told)
        fit = fit_rotary_centres(machine, np.array(toucher.touched), wanted.reach, wanted.beyond)
        return fit, client.machine


def _touch_all(
    toucher: _Toucher, wanted: BallProbing, machine: Machine, state: Any,
    told: Callable[[str], None],
) -> None:  # fmt: skip
    transform, names = Transform.of(machine), machine.axis_names[3:5]
    tip, axis = transform.forward(np.array([state.commanded_positions]))
    if not machine.has_rotary or axis[0, 2] < 1.0 - UPRIGHT:
        raise InterpError('stand upright above the ball, with the rotary axes at zero')
    way, reach = wanted.beside, wanted.reach
    for line in ('G21 G90 G94 M428', f'#<_probe_feed>={wanted.feed:g}',
                 f'#<_probe_slow>={wanted.slow:g}'):  # fmt: skip
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
