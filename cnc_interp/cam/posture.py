"""Postures: position and orientation of the mill at a guided point, and its motion there.

With tilt theta and yaw y about n, ``f_y = f cos y - t sin y`` (n x f = -t) and
``t_y = t cos y + f sin y``:

    u   = n cos(theta) + f_y sin(theta)         tool axis, which leans forward
    e_f = f_y cos(theta) - n sin(theta)         towards K in the plane of the corner circle
    C_L = K - R e_f

The mill therefore touches the surface at K - r_c n, and its heel is lifted.
"""

from dataclasses import dataclass

import numpy as np

from cnc_interp.cam.cutter import Cutter
from cnc_interp.cam.guiding import CurveFrames
from cnc_interp.core import FloatArray, cross, scaled


@dataclass(frozen=True)
class Postures:
    cutter: Cutter  #: The mill.
    frames: CurveFrames  #: Guided points and their frames.
    #: (n,): Angles [rad].
    tilt: FloatArray
    yaw: FloatArray
    #: (n,): Derivatives of the angles by arc length of K [rad/m].
    tilt_rate: FloatArray
    yaw_rate: FloatArray

    def __len__(self) -> int:
        return len(self.tilt)

    @property
    def turned(self) -> tuple[FloatArray, FloatArray]:
        """Feed and across direction, turned by the yaw about n."""
        c, s = np.cos(self.yaw), np.sin(self.yaw)
        f, t = self.frames.feed, self.frames.across
        return scaled(c, f) - scaled(s, t), scaled(c, t) + scaled(s, f)

    @property
    def axis(self) -> FloatArray:
        f_y = self.turned[0]
        return scaled(np.cos(self.tilt), self.frames.normal) + scaled(np.sin(self.tilt), f_y)

    @property
    def front(self) -> FloatArray:
        f_y = self.turned[0]
        return scaled(np.cos(self.tilt), f_y) - scaled(np.sin(self.tilt), self.frames.normal)

    @property
    def centre(self) -> FloatArray:
        return np.asarray(self.frames.position - self.cutter.tool_radius * self.front)

    @property
    def tip(self) -> FloatArray:
        return self.cutter.tip(self.centre, self.axis)

    @property
    def contact(self) -> FloatArray:
        return self.frames.position - self.cutter.corner_radius * self.frames.normal

    @property
    def turn(self) -> FloatArray:
        """Rotation vector per arc length [TL2008, Eq. 3.5-3.6]: Omega_R1 + yaw' n - tilt' t_y."""
        own = scaled(self.yaw_rate, self.frames.normal) - scaled(self.tilt_rate, self.turned[1])
        return np.asarray(self.frames.turn + own)

    def velocity(self, points: FloatArray) -> FloatArray:
        """Return V_P of points (n, ..., 3) of the mill per arc length of K [TL2008, Eq. 3.4]."""
        extra = points.ndim - 2
        shape = (len(self), *[1] * extra, 3)
        away = points - self.frames.position.reshape(shape)
        turn = np.broadcast_to(self.turn.reshape(shape), away.shape)
        return np.asarray(self.frames.feed.reshape(shape) + cross(turn, away))

    def rim(self, angle: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return directions from C_L in the plane of the corner circle."""
        e_f, e_t = self.front, self.turned[1]
        c, s = np.cos(angle), np.sin(angle)
        return scaled(c, e_f) + scaled(s, e_t), scaled(c, e_t) - scaled(s, e_f)
