"""Forward kinematics of an arm, computed again from its files, link by link."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol
from xml.etree import ElementTree

import numpy as np

from cnc_interp.core import DEG, MM, FloatArray, InterpError
from cnc_interp.core.small_files import read_yaml, small_text
from cnc_interp.machine_model.machine import Machine, find_machine_file
from cnc_interp.machine_model.transform_port import Transform

LONGEST = 1 << 22  #: Longest URDF [bytes].


class Forward(Protocol):
    def forward(self, q: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return tool tips [m] and unit tool axes in W, (n, 3) each, for rows of q."""

    def tool_axis(self, rotary: FloatArray) -> FloatArray:
        """Return the tool axes (n, 3) at positions of rotary axes."""


def forward_of(machine: Machine) -> Forward:
    return Transform.of(machine) if machine.arm is None else OwnChain.of(machine)


@dataclass(frozen=True)
class OwnChain:
    #: Fixed transforms (4, 4), and the axis (3,) of the joint between each two of them.
    frames: list[FloatArray]
    axes: list[FloatArray]

    @staticmethod
    def of(machine: Machine) -> OwnChain:
        file = find_machine_file(machine.file or machine.name)
        content = read_yaml(file)
        given = content['urdf']  # the name of a file, or all of it
        text = given if '<' in given else small_text(file.parent / given, LONGEST)
        robot = ElementTree.fromstring(text)
        above = {
            joint.find('child').attrib['link']: joint  # type: ignore[union-attr]
            for joint in robot.findall('joint')
        }
        links = _Links(above)
        frames, axes = links.between(content['base'], content['flange'])
        frames[0] = np.linalg.inv(links.frame(content['part'], content['base'])) @ frames[0]
        frames[-1] = frames[-1] @ links.frame(content['tcp'], content['flange'])
        return OwnChain(frames, axes)

    def forward(self, q: FloatArray) -> tuple[FloatArray, FloatArray]:
        pose = np.broadcast_to(self.frames[0], (len(q), 4, 4))
        for k, axis in enumerate(self.axes):
            x, y, z = axis
            across = np.zeros((4, 4))
            across[:3, :3] = [[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]]
            angle = q[:, k, None, None]
            turn = np.eye(4) + np.sin(angle) * across + (1.0 - np.cos(angle)) * across @ across
            pose = pose @ turn @ self.frames[k + 1]
        return pose[:, :3, 3], -pose[:, :3, 2]

    def tool_axis(self, rotary: FloatArray) -> FloatArray:
        raise InterpError('blocks.npz has rotary words, and an arm has no axes for them')


@dataclass(frozen=True)
class _Links:
    above: dict[str, ElementTree.Element]

    def between(self, base: str, link: str) -> tuple[list[FloatArray], list[FloatArray]]:
        frames, axes = [np.eye(4)], list[FloatArray]()
        while link != base:
            joint = self.above[link]
            link = joint.find('parent').attrib['link']  # type: ignore[union-attr]
            if joint.attrib['type'] != 'fixed':
                along = joint.find('axis')
                words = '1 0 0' if along is None else along.attrib['xyz']
                axis = np.array([float(word) for word in words.split()])
                axes.insert(0, axis / np.sqrt(axis @ axis))
                frames.insert(0, np.eye(4))
            origin = joint.find('origin')
            given = {} if origin is None else origin.attrib
            xyz, rpy = (
                [float(word) for word in given.get(key, '0 0 0').split()] for key in ('xyz', 'rpy')
            )
            frames[0] = _frame(xyz, rpy) @ frames[0]
        return frames, axes

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
