"""Forward kinematics of an arm, computed again from its files, link by link."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol
from xml.etree import ElementTree

import numpy as np

from cnc_interp.core import DEG, MM, FloatArray, InterpError
from cnc_interp.machine_model.machine import Machine, content_of
from cnc_interp.machine_model.transform_port import Transform

ARM = 6  #: Number of joints of an arm.


class Forward(Protocol):
    def forward(self, q: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return tool tips [m] and unit tool axes in W, (n, 3) each, for rows of q."""

    def tool_axis(self, rotary: FloatArray) -> FloatArray:
        """Return the tool axes (n, 3) at positions of rotary axes."""


def forward_of(machine: Machine) -> Forward:
    return Transform.of(machine) if machine.arm is None else OwnChain.of(machine)


@dataclass(frozen=True)
class OwnChain:
    #: Fixed transforms (4, 4), and the joint between each two of them: its axis (3,), reversed
    #: where the chain runs from child to parent; whether the joint slides; its column in q.
    frames: list[FloatArray]
    joints: list[tuple[FloatArray, bool, int]]

    @staticmethod
    def of(machine: Machine) -> OwnChain:
        content = content_of(machine.file or machine.name)
        robot = ElementTree.fromstring(content['urdf'])
        links = _Links(
            {joint.find('child').attrib['link']: joint for joint in robot.findall('joint')}  # type: ignore[union-attr]
        )
        frames, axes = links.between(content['base'], content['flange'])
        frames[0] = np.linalg.inv(links.frame(content['part'], content['base'])) @ frames[0]
        frames[-1] = frames[-1] @ links.frame(content['tcp'], content['flange'])
        # The joints of the arm come last in the chain, and have the first columns.
        columns = [*range(ARM, len(axes)), *range(ARM)]
        return OwnChain(frames, [(*one, k) for one, k in zip(axes, columns, strict=True)])

    def poses(self, q: FloatArray) -> FloatArray:
        """Return the poses of the TCP in the part (n, 4, 4) for rows of q."""
        pose = np.broadcast_to(self.frames[0], (len(q), 4, 4))
        for frame, (axis, slides, k) in zip(self.frames[1:], self.joints, strict=True):
            x, y, z = axis
            across, at = np.zeros((4, 4)), q[:, k, None, None]
            across[:3, :3] = [[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]]
            turn = np.eye(4) + np.sin(at) * across + (1.0 - np.cos(at)) * across @ across
            shift = np.zeros((4, 4))
            shift[:3, 3] = axis
            pose = pose @ (np.eye(4) + at * shift if slides else turn) @ frame
        return pose

    def forward(self, q: FloatArray) -> tuple[FloatArray, FloatArray]:
        pose = self.poses(q)
        return pose[:, :3, 3], -pose[:, :3, 2]

    def spins(self, q: FloatArray) -> FloatArray:
        """Return the spin of the tool about its axis, (n,) [rad].

        Its zero is X of the part after the least rotation from Z of the part to the tool axis.
        """
        pose = self.poses(q)
        side, axis = pose[:, :3, 0], -pose[:, :3, 2]
        across, x = np.zeros((len(q), 3, 3)), np.array([1.0, 0.0, 0.0])
        across[:, 0, 2], across[:, 2, 0] = axis[:, 0], -axis[:, 0]
        across[:, 1, 2], across[:, 2, 1] = axis[:, 1], -axis[:, 1]
        zero = x + across @ x + across @ across @ x / (1.0 + axis[:, 2:])
        sine = (np.cross(zero, side) * axis).sum(axis=1)
        return np.arctan2(sine, (zero * side).sum(axis=1))

    def tool_axis(self, rotary: FloatArray) -> FloatArray:
        raise InterpError('blocks.npz has rotary words, and an arm has no axes for them')


@dataclass(frozen=True)
class _Links:
    above: dict[str, ElementTree.Element]

    def between(
        self, base: str, link: str
    ) -> tuple[list[FloatArray], list[tuple[FloatArray, bool]]]:
        """Return the frames between the joints from one link to another, and these joints."""
        up, down = self.upward(base), self.upward(link)
        while up and down and up[-1] is down[-1]:
            del up[-1], down[-1]
        frames, joints = [np.eye(4)], list[tuple[FloatArray, bool]]()
        for joint in up + down[::-1]:
            origin, along = joint.find('origin'), joint.find('axis')
            given = {} if origin is None else origin.attrib
            xyz, rpy = (
                [float(word) for word in given.get(key, '0 0 0').split()] for key in ('xyz', 'rpy')
            )
            backwards, frame = joint in up, _frame(xyz, rpy)
            if not backwards:
                frames[-1] = frames[-1] @ frame
            if joint.attrib['type'] != 'fixed':
                words = '1 0 0' if along is None else along.attrib['xyz']
                axis = np.array([float(word) for word in words.split()])
                axis /= -np.sqrt(axis @ axis) if backwards else np.sqrt(axis @ axis)
                joints.append((axis, joint.attrib['type'] == 'prismatic'))
                frames.append(np.eye(4))
            if backwards:
                frames[-1] = frames[-1] @ np.linalg.inv(frame)
        return frames, joints

    def upward(self, link: str) -> list[ElementTree.Element]:
        found = list[ElementTree.Element]()
        while link in self.above:
            found.append(self.above[link])
            link = found[-1].find('parent').attrib['link']  # type: ignore[union-attr]
        return found

    def frame(self, given: Any, link: str) -> FloatArray:
        if isinstance(given, str):
            return self.between(link, given)[0][0]
        xyz, rpy = (np.array(given.get(key, [0.0] * 3)) for key in ('xyz_mm', 'rpy_deg'))
        return _frame(xyz * MM, rpy * DEG)


def _frame(xyz: Any, rpy: Any) -> FloatArray:
    found = np.eye(4)
    for angle, (i, j) in zip(rpy, ((1, 2), (2, 0), (0, 1)), strict=True):
        turn = np.eye(4)
        turn[[i, j], [i, j]] = np.cos(angle)
        turn[j, i], turn[i, j] = np.sin(angle), -np.sin(angle)
        found = turn @ found
    found[:3, 3] = xyz
    return found
