"""
What joint_trajectory_controller of ros2_control does with messages of its topic, without ROS.

Written from its documentation and observed behaviour (release Jazzy, interpolation from the
desired state): what it refuses, how it replaces a running trajectory, which polynomial it takes
between points, what it does when a tolerance is broken.
"""

from itertools import pairwise

import numpy as np

SECOND = 10**9
#: A velocity up to this counts as rest at the end of a trajectory.
REST = float(np.finfo(np.float32).eps)


def time_of(stamp):
    return stamp.sec * SECOND + stamp.nanosec


class ControllerModel:
    """One controller; times in ns, positions in m and rad."""

    def __init__(self, joints, position, tolerance=np.inf, goal_tolerance=np.inf, goal_time=0.0):
        self.joints = list(joints)
        self.tolerance, self.goal_tolerance = tolerance, goal_tolerance
        self.goal_time = goal_time
        self.aborted = ''
        #: Whether the last command lay between points of a message, not on a way to the first.
        self.between_points = False
        self._points, self._before = None, None
        self._last = np.array([position, np.zeros(len(joints)), np.zeros(len(joints))])

    def refusal(self, message, now):
        """Why a message is not taken; empty if it is."""
        names, points = list(message.joint_names), message.points
        if len(names) != len(self.joints) or set(names) != set(self.joints):
            return f'joints {names} are not those of the controller'
        if not points:
            return 'no points'
        if any(abs(v) > REST for v in points[-1].velocities):
            return 'the trajectory does not end at rest'
        stamp, times = time_of(message.header.stamp), [time_of(p.time_from_start) for p in points]
        if stamp and stamp + times[-1] < now:
            return 'the trajectory ends in the past'
        if any(b <= a for a, b in pairwise(times)):
            return 'times do not increase'
        for point in points:
            if len(point.positions) != len(names):
                return 'a point without positions of all joints'
            for given in (point.velocities, point.accelerations):
                if len(given) not in (0, len(names)):
                    return 'a point with too few derivatives'
            if len(point.effort):
                return 'effort is not commanded'
        return ''

    def take(self, message, now):
        """Replace the running trajectory, unless the message is refused; returns the refusal."""
        why = self.refusal(message, now)
        if why:
            return why
        order = [list(message.joint_names).index(name) for name in self.joints]
        start = time_of(message.header.stamp) or now
        self._points = [
            (
                start + time_of(p.time_from_start),
                *(
                    np.array(given)[order] if len(given) else None
                    for given in (p.positions, p.velocities, p.accelerations)
                ),
            )
            for p in message.points
        ]
        self._before, self.aborted = None, ''
        return ''

    def update(self, now, measured):
        """One cycle: the command at a time, shape (3, n): position, velocity, acceleration."""
        if self._points is None:
            return self._last
        if self._before is None:
            self._before = (now, *self._last)
        points, place = [self._before, *self._points], 0
        while place < len(points) and points[place][0] <= now:
            place += 1
        self.between_points = place > 1
        if place == len(points):
            wanted = np.array([points[-1][1], *np.zeros((2, len(self.joints)))])
        else:
            wanted = between(points[place - 1], points[place], now)
        limit = self.tolerance
        if place == len(points):
            late = now - points[-1][0] > self.goal_time * SECOND
            limit = self.goal_tolerance if self.goal_time and late else np.inf
        if np.any(np.abs(wanted[0] - measured) > limit):
            self.aborted = 'goal tolerance' if place == len(points) else 'path tolerance'
            self._points = None
            wanted = np.array([measured, *np.zeros((2, len(self.joints)))])
        self._last = wanted
        return wanted


def powers(u, order, count):
    """The derivative of some order of 1, u, u^2 ..."""
    factors = [np.prod(range(k - order + 1, k + 1)) if k >= order else 0 for k in range(count)]
    return np.array([f * u ** max(k - order, 0) for k, f in enumerate(factors)], dtype=float)


#: From position and derivatives at 0, then at 1, to the coefficients; by the number of both.
COEFFICIENTS = {
    2 * known: np.linalg.inv(
        [powers(u, order, 2 * known) for u in (0.0, 1.0) for order in range(known)]
    )
    for known in (1, 2, 3)
}


def between(first, last, now):
    """Interpolate with the degree that both points' derivatives allow: 1, 3 or 5."""
    (t0, *start), (t1, *end) = first, last
    span, u = (t1 - t0) / SECOND, (now - t0) / (t1 - t0)
    known = next((k for k in range(3) if start[k] is None or end[k] is None), 3)
    given = [row[k] * span**k for row in (start, end) for k in range(known)]
    given[0], given[known] = 0.0 * start[0], end[0] - start[0]
    found = COEFFICIENTS[2 * known] @ np.array(given)
    wanted = np.array([powers(u, k, 2 * known) @ found / span**k for k in range(3)])
    wanted[0] += start[0]
    return wanted
