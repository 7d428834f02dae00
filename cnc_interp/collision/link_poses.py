"""Poses of the links of a machine, and the joints between two links.

Poses are those of ``machine_model/links.py``, in the machine frame M. Seen from link B, a point of
link A moves by the joints from A up to the link that carries both (sense +1), and then by the
joints from that link down to B (sense -1).
"""

from __future__ import annotations

from math import cos, sin
from typing import NamedTuple

import numpy as np

from cnc_interp.core import FloatArray, IntArray
from cnc_interp.core.kernels import njit
from cnc_interp.machine_model.links import joints_of
from cnc_interp.machine_model.machine import Machine


class Chain(NamedTuple):
    """The links of a machine as arrays; link 0 is the base, and link k the child of joint k."""

    parent: IntArray  #: (n,): Link that carries each link; -1 of the base.
    axis: IntArray  #: (n,): Axis of the joint before each link; -1 of a fixed one.
    linear: IntArray  #: (n,): 1 if that axis is linear, else 0.
    origin: FloatArray  #: (n, 3): Origin of the link in the frame of its parent [m].
    along: FloatArray  #: (n, 3): Direction of the axis [-].
    turn: FloatArray  #: (n, 3, 3): How the link is turned in its parent, with the axis at zero.
    turned: IntArray  #: (n,): 1 where it is.


def chain_of(machine: Machine) -> tuple[Chain, tuple[str, ...]]:
    """Return the chain of a machine and the names of its links."""
    joints = joints_of(machine)
    names = (joints[0].parent, *(joint.child for joint in joints))
    numbers = {name: k for k, name in enumerate(names)}
    chain = Chain(
        np.array([-1, *(numbers[joint.parent] for joint in joints)]),
        np.array([-1, *(joint.axis for joint in joints)]),
        np.array([0, *(int(joint.kind == 'prismatic') for joint in joints)]),
        np.array([(0.0, 0.0, 0.0), *(joint.origin for joint in joints)]),
        np.array([(0.0, 0.0, 1.0), *(joint.along for joint in joints)]),
        np.array([np.eye(3), *(joint.turn for joint in joints)]),
        np.array([0, *(int(any(joint.rpy)) for joint in joints)]),
    )
    return chain, names


def steps_between(chain: Chain, a: int, b: int) -> list[tuple[int, float]]:
    """Return the links whose joints lie between links a and b, with their sense, from a on."""
    up, down = _to_base(chain, a), _to_base(chain, b)
    while up and down and up[-1] == down[-1]:
        up.pop()
        down.pop()
    steps = [(link, 1.0) for link in up] + [(link, -1.0) for link in reversed(down)]
    return [(link, sense) for link, sense in steps if chain.axis[link] >= 0]


def _to_base(chain: Chain, link: int) -> list[int]:
    way = []
    while link > 0:
        way.append(link)
        link = int(chain.parent[link])
    return way


def step_table(chain: Chain) -> tuple[IntArray, FloatArray, IntArray]:
    """Return the steps between all links: first step (n n + 1,), senses and links of all steps."""
    n = len(chain.parent)
    every = [steps_between(chain, a, b) for a in range(n) for b in range(n)]
    first = np.cumsum([0, *map(len, every)])
    flat = [step for steps in every for step in steps]
    links = np.array([link for link, _ in flat], dtype=np.int64)
    return first, np.array([sense for _, sense in flat], dtype=float), links


@njit(cache=True, nogil=True)
def placed_turn(pose: FloatArray, turn: FloatArray) -> FloatArray:
    """Return the rotation of a link (9,) whose parent has a pose (12,), with its axis at zero."""
    found = np.empty(9)
    for i in range(3):
        for j in range(3):
            found[3 * i + j] = (
                pose[3 * i] * turn[0, j]
                + pose[3 * i + 1] * turn[1, j]
                + pose[3 * i + 2] * turn[2, j]
            )
    return found


@njit(cache=True, nogil=True)
def pose_links(chain: Chain, q: FloatArray, pose: FloatArray) -> None:
    """Write rotation and origin in M of every link at axis positions q, (n, 12) [-, m].

    The origin lies on the axis of the joint before the link, so that joint does not move it.
    """
    pose[0, :] = 0.0
    pose[0, 0] = pose[0, 4] = pose[0, 8] = 1.0
    for k in range(1, len(chain.parent)):
        p, o = pose[chain.parent[k]], chain.origin[k]
        u = chain.along[k]
        x, y, z = o[0], o[1], o[2]
        value = q[chain.axis[k]] if chain.axis[k] >= 0 else 0.0
        if chain.axis[k] >= 0 and chain.linear[k] == 1:
            x, y, z = x + value * u[0], y + value * u[1], z + value * u[2]
        for i in range(3):
            pose[k, 9 + i] = p[9 + i] + p[3 * i] * x + p[3 * i + 1] * y + p[3 * i + 2] * z
        if chain.turned[k]:
            p = placed_turn(p, chain.turn[k])
        if chain.axis[k] < 0 or chain.linear[k] == 1:
            pose[k, :9] = p[:9]
            continue
        s, c = sin(value), cos(value)
        d = 1.0 - c
        # The rotation of this joint, Rodrigues' formula, row by row.
        r = (
            (c + d * u[0] * u[0], d * u[0] * u[1] - s * u[2], d * u[0] * u[2] + s * u[1]),
            (d * u[1] * u[0] + s * u[2], c + d * u[1] * u[1], d * u[1] * u[2] - s * u[0]),
            (d * u[2] * u[0] - s * u[1], d * u[2] * u[1] + s * u[0], c + d * u[2] * u[2]),
        )
        for i in range(3):
            for j in range(3):
                pose[k, 3 * i + j] = (
                    p[3 * i] * r[0][j] + p[3 * i + 1] * r[1][j] + p[3 * i + 2] * r[2][j]
                )


@njit(cache=True, nogil=True, inline='always')
def turned(pose: FloatArray, v: tuple[float, float, float]) -> tuple[float, float, float]:
    """Return in M a vector given in the frame of a link; ``pose`` (12,): of the link."""
    return (
        pose[0] * v[0] + pose[1] * v[1] + pose[2] * v[2],
        pose[3] * v[0] + pose[4] * v[1] + pose[5] * v[2],
        pose[6] * v[0] + pose[7] * v[1] + pose[8] * v[2],
    )


@njit(cache=True, nogil=True, inline='always')
def turned_back(pose: FloatArray, v: tuple[float, float, float]) -> tuple[float, float, float]:
    """Return in the frame of a link a vector given in M."""
    return (
        pose[0] * v[0] + pose[3] * v[1] + pose[6] * v[2],
        pose[1] * v[0] + pose[4] * v[1] + pose[7] * v[2],
        pose[2] * v[0] + pose[5] * v[1] + pose[8] * v[2],
    )


@njit(cache=True, nogil=True, inline='always')
def placed(pose: FloatArray, p: tuple[float, float, float]) -> tuple[float, float, float]:
    x, y, z = turned(pose, p)
    return x + pose[9], y + pose[10], z + pose[11]
