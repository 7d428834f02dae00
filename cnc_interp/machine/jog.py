"""Motion by hand: a beat requests velocities, a move a target; both become setpoints."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from cnc_interp.core import FloatArray, StreamError
from cnc_interp.machine.axis_motion import refuse_setpoints
from cnc_interp.machine.jog_motion import LEAST_SHARE, JogMotion
from cnc_interp.machine.playback import Playback
from cnc_interp.machine.slides import THERE, Slides
from cnc_interp.machine.tool_slide import along_tool
from cnc_interp.run.clearance_stage import Foresight
from cnc_interp.run.run_state import Reason, RunId, State
from cnc_interp.run.setpoints import Chunk

LATE = 0.2  #: The motion stops if no beat arrives for this time [s].
GIVEN_UP = 3.0  #: After this time without a beat, the jog key counts as released [s].
AHEAD, PIECE = 0.05, 0.01  #: Duration of motion buffered in the machine, and of one chunk [s].
JOG = 'jog'  #: ``program_id`` of motions by hand; ``attempt`` counts these motions.


@dataclass(frozen=True, eq=False)
class Beat:
    """Velocities over their limits, (m,) [-]; they apply for ``LATE`` seconds."""

    slides: Slides
    shares: FloatArray


@dataclass(frozen=True, eq=False)
class Move:
    """Target coordinates, (m,) [m, rad], and speed as a share of the velocity limits [-]."""

    slides: Slides
    target: FloatArray
    speed: float


class Jog:
    def __init__(self, playback: Playback, contact: Foresight | None = None):
        self._contact = contact
        self._playback, self._machine = playback, playback.axes.machine
        self._period = playback.axes.period
        self._axes = Slides.of_axes(self._machine)
        self._drives = Slides.of_drives(self._machine)
        #: Whether axes move in commanded instead of nominal coordinates, as while homing.
        self.by_drives = False
        self._wish: Beat | Move | None = None
        self._beat_at = -math.inf
        self._held = False  # the last beat moves axes
        self._released = True  # after a hold the keys must be let go
        self._seen = playback.state
        self._motion: JogMotion | None = None
        self._override = 1.0
        self._steered: tuple[Beat | Move | None, float] = (None, 0.0)  # wish and override
        self._count = 0  # motions

    @property
    def target(self) -> FloatArray:
        """Nominal target of the current move; without a move, the last setpoint [m, rad]."""
        if isinstance(self._wish, Move):
            return self._wish.slides.nominal(self._wish.target[None, :])[0]
        return self._axes.coordinates(self._before[-1])

    # Requests of the operator -------------------------------------------------------------------

    def beat(self, shares: Mapping[str, float], tool: float, now: float) -> float:
        """Process a beat; return the silence that stopped a jog before it [s], else 0.

        ``shares``: velocity of each axis over its limit, -1 to 1; ``tool``: the same along the
        tool; ``now``: monotonic time [s]. Raises StreamError if the jog is not possible.
        """
        wanted = np.array([tool]) if tool else self._of_axes(shares, 0.0)
        self._check(shares, tool)
        if not (np.abs(wanted) <= 1.0).all():
            raise StreamError('jog: shares must be between -1 and 1')
        silence = now - self._beat_at
        moves, fresh = bool(wanted.any()), silence > LATE
        if moves and isinstance(self._wish, Move):
            raise StreamError('a move is in progress; feed_hold ends it')
        ended = silence if self._held and LATE < silence < GIVEN_UP else 0.0
        self._beat_at, self._held = now, False
        self._released = self._released or fresh or not moves
        if not moves:
            self._wish = None if isinstance(self._wish, Beat) else self._wish
            return ended
        self._playback.check_jog()
        slides, before = self._slides(bool(tool)), self._wish
        if slides is None or not self._released:
            self._wish = None
        elif not (isinstance(before, Beat) and np.array_equal(before.shares, wanted)):
            self._wish = Beat(slides, wanted)
        self._held = self._wish is not None
        return ended

    def move(
        self, values: Mapping[str, float], relative: bool, tool: float, speed: float
    ) -> FloatArray:
        """Accept a move; return its nominal target, (n_axes,) [m, rad], or raise StreamError.

        ``values``: target of each moving axis [m, rad]. If ``relative``, they count from the
        target of the current move or, without one, from the current position. ``tool``: distance
        along the tool [m]; ``speed``: share of the velocity limits [-]; 0 means full speed.
        """
        wanted = np.array([tool]) if tool else self._of_axes(values, math.nan)
        self._check(values, tool)
        if not (values or tool):
            raise StreamError(
                'move_axes: name an axis and its target, or a distance along the tool'
            )
        if speed and not LEAST_SHARE <= speed <= 1.0:
            raise StreamError(f'move_axes: the speed is {speed:g}; from {LEAST_SHARE:g} to 1')
        self._playback.check_jog()
        if self._override * (speed or 1.0) < LEAST_SHARE:
            raise StreamError(f'the feed override is {self._override:g}; raise it')
        if isinstance(self._wish, Beat):
            raise StreamError('the axes are being jogged; release the key first')
        slides = self._slides(bool(tool))
        if slides is None:
            raise StreamError('the axes are still moving; wait until they rest')
        base = slides.coordinates(self._before[-1])
        base = self._wish.target if isinstance(self._wish, Move) else base
        wanted = base + wanted if relative or tool else wanted
        target = np.where(np.isfinite(wanted), wanted, base)
        self._refuse_beyond(slides.positions(target[None, :])[0])
        self._wish = Move(slides, target, speed or 1.0)
        return slides.nominal(target[None, :])[0]

    def _check(self, values: Mapping[str, float], tool: float) -> None:
        if values and tool:
            raise StreamError('move either axes or along the tool')
        if not np.isfinite([*values.values(), tool]).all():
            raise StreamError('a value is not finite; send numbers')

    def _of_axes(self, values: Mapping[str, float], nothing: float) -> FloatArray:
        names = self._machine.axis_names
        for name in values:
            if name not in names:
                raise StreamError(f'the machine has no axis {name!r} (axes: {" ".join(names)})')
        return np.array([values.get(name, nothing) for name in names])

    def _slides(self, tool: bool) -> Slides | None:
        motion = self._motion
        if motion is None:
            stands = self._axes.coordinates(self._before[-1])
            axes = self._drives if self.by_drives else self._axes
            return along_tool(self._machine, stands) if tool else axes
        return motion.slides if tool is (len(motion.x) == 1) else None

    def _refuse_beyond(self, place: FloatArray) -> None:
        for axis, value in zip(self._machine.axes, place, strict=True):
            if not axis.travel[0] - THERE <= value <= axis.travel[1] + THERE:
                low, high = map(axis.position_text, axis.travel)
                raise StreamError(
                    f'{axis.name} would go to {axis.position_text(value)} {axis.shown_unit}; '
                    f'its travel is {low} to {high}'
                )

    # What the machine does ----------------------------------------------------------------------

    def work(self, now: float, override: float) -> None:
        """Send the next setpoints to the machine; raise StreamError if a motion was stopped."""
        playback, state, self._override = self._playback, self._playback.state, override
        before, self._seen = self._seen, state
        if state is not before:
            held = state.reason is Reason.FEED_HOLD and before.state is not State.HELD
            if held or not (state.by_hand or state.state in (State.IDLE, State.HELD)):
                self._wish, self._released = None, False
        if isinstance(self._wish, Beat) and now - self._beat_at > LATE:
            self._wish = None
        try:
            if not state.by_hand:
                self._motion = None
                if self._wish is not None:
                    self._begin(self._wish)
            elif (motion := self._motion) and not (motion.over or playback.plans.is_left(state)):
                self._steer(motion)
                self._fill(motion)
        except StreamError:
            self._wish, self._released = None, False
            raise

    def _begin(self, wish: Beat | Move) -> None:
        coordinates = wish.slides.coordinates(self._before[-1])
        motion = JogMotion(wish.slides, self._period, coordinates, self._contact)
        self._steer(motion)
        if motion.over:
            self._fill(motion)
            return
        self._count += 1
        self._playback.begin_jog(RunId(JOG, self._count), self._piece(motion))
        self._motion = motion
        self._fill(motion)

    def _steer(self, motion: JogMotion) -> None:
        wish, override = self._wish, self._override
        if motion is self._motion and self._steered == (wish, override):
            return
        self._steered = wish, override
        if isinstance(wish, Beat):
            shares = np.clip(override * wish.shares, -1.0, 1.0)
            motion.run(shares * wish.slides.limits.max_velocity)
        elif wish is not None and override * wish.speed >= LEAST_SHARE:
            motion.go(wish.target, min(1.0, override * wish.speed))
        else:
            self._wish = None
            motion.stop()

    def _fill(self, motion: JogMotion) -> None:
        while not motion.over and self._playback.plans.buffer.count < self._setpoints(AHEAD):
            taken = self._playback.push(self._piece(motion))
            if motion.blocked is not None:
                hit, motion.blocked = motion.blocked, None
                raise hit
            if not taken:
                return
        if motion.over and isinstance(self._wish, Move):
            self._wish = None

    def _piece(self, motion: JogMotion) -> Chunk:
        """Return the next setpoints, after the checks that setpoints of programs also pass."""
        chunk = motion.piece(self._setpoints(PIECE))
        rows = np.concatenate([chunk.samples.position, chunk.tail.position])
        refuse_setpoints(self._machine, self._period, self._before, rows)
        return chunk

    @property
    def _before(self) -> FloatArray:
        """The last three buffered setpoints, which the next ones follow, (3, n_axes) [m, rad]."""
        playback = self._playback
        if playback.state.by_hand:
            return playback.plans.buffer.newest
        return np.tile(playback.axes.setpoints[-1], (3, 1))

    def _setpoints(self, time: float) -> int:
        return max(1, round(time / self._period))
