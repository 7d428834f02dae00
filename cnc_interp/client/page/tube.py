"""
The tool path as a thin tube coloured by feedrate, in binary glTF 2.0.

Browsers draw lines one pixel wide, whatever is asked; a tube has a width and takes light.
"""

from __future__ import annotations

import json
import struct
from typing import Any

import numpy as np

from cnc_interp.core.arrays import FloatArray, IntArray

SIDES = 5
#: Triangles between two neighbouring points.
FACES = 2 * SIDES
#: What is not drawn changes the course by less than this share of the radius, and red, green
#: and blue by less than this share of full.
UNSEEN, INDISTINCT = 0.25, 0.04
#: A carried vector of which less is left has turned into the tangent: a new one is taken.
TURNED_INTO = 0.1
#: Slow to fast, evenly spaced: legible on dark ground.
SCALE = ((58, 84, 196), (43, 176, 220), (96, 204, 120), (244, 208, 63), (231, 90, 60))
MAGIC, JSON_CHUNK, BINARY_CHUNK = 0x46546C67, 0x4E4F534A, 0x004E4942
FLOAT, UNSIGNED_INT, UNSIGNED_BYTE = 5126, 5125, 5121
ARRAY_BUFFER, ELEMENT_BUFFER = 34962, 34963


def tube(
    points: FloatArray, values: FloatArray, top: float, radius: float
) -> tuple[bytes, IntArray]:
    """Make a glTF file of a tube along points, coloured from 0 to ``top``."""
    colours = colours_of(values, top)
    kept = thinned(np.column_stack([points / (UNSEEN * radius), colours / (255.0 * INDISTINCT)]))
    points, colours = points[kept], colours[kept]
    moved = np.concatenate([[True], np.abs(np.diff(points, axis=0)).max(axis=1) > 0.0])
    points, colours, kept = points[moved], colours[moved], kept[moved]
    if len(points) < 2:
        points = np.stack([points[0], points[0] + [0.0, 0.0, radius]])
        colours, kept = np.repeat(colours[:1], 2, axis=0), kept[[0, -1]]
    vertices, normals = rings(points, radius)
    shades = np.repeat(colours, SIDES, axis=0)
    file = glb(vertices.astype('<f4'), normals.astype('<f4'), shades, faces(len(points)))
    return file, kept


def thinned(points: FloatArray) -> Any:
    """
    Choose rows of a polyline so that no other row is farther than 1 from the chord over it.

    Douglas and Peucker's way, in any number of dimensions; both ends are chosen.
    """
    kept = np.zeros(len(points), dtype=bool)
    kept[[0, -1]] = True
    waiting = [(0, len(points) - 1)]
    while waiting:
        first, last = waiting.pop()
        off = points[first + 1 : last] - points[first]
        chord = points[last] - points[first]
        along = np.clip(off @ chord / max(chord @ chord, np.finfo(float).tiny), 0.0, 1.0)
        square = ((off - along[:, None] * chord) ** 2).sum(axis=1)
        if square.max(initial=0.0) > 1.0:
            worst = first + 1 + int(square.argmax())
            kept[worst] = True
            waiting += [(first, worst), (worst, last)]
    return np.flatnonzero(kept)


def colours_of(values: FloatArray, top: float) -> Any:
    """Return red, green, blue and opacity of values on the scale, shape (N, 4), bytes."""
    place = np.clip(values / top, 0.0, 1.0) if top > 0.0 else np.zeros(len(values))
    known = np.linspace(0.0, 1.0, len(SCALE))
    rgb = [np.interp(place, known, [colour[k] for colour in SCALE]) for k in range(3)]
    return np.stack([*rgb, np.full(len(values), 255.0)], axis=1).round().astype(np.uint8)


def rings(points: FloatArray, radius: float) -> tuple[FloatArray, FloatArray]:
    """Return vertices and normals of the rings around the points, shape (N * SIDES, 3)."""
    chord = np.diff(points, axis=0)
    chord /= np.linalg.norm(chord, axis=1, keepdims=True)
    before = np.concatenate([chord[:1], chord])
    both = before + np.concatenate([chord, chord[-1:]])
    length = np.linalg.norm(both, axis=1, keepdims=True)
    # Where the path turns back on itself it has no middle direction.
    tangent = np.divide(both, length, out=before, where=length > TURNED_INTO)
    across = carried(tangent)
    beside = np.cross(tangent, across)
    angle = 2.0 * np.pi * np.arange(SIDES) / SIDES
    normals = (
        np.cos(angle)[None, :, None] * across[:, None, :]
        + np.sin(angle)[None, :, None] * beside[:, None, :]
    )
    vertices = points[:, None, :] + radius * normals
    return vertices.reshape(-1, 3), normals.reshape(-1, 3)


def carried(tangent: FloatArray) -> FloatArray:
    """Return unit vectors across the tangents, carried along with little turning."""
    found = np.empty_like(tangent)
    now = np.zeros(3)
    for k, t in enumerate(tangent):
        now = now - (now @ t) * t
        size = np.sqrt(now @ now)
        if size < TURNED_INTO:
            now = np.cross(t, np.eye(3)[np.abs(t).argmin()])
            size = np.sqrt(now @ now)
        found[k] = now = now / size
    return found


def faces(count: int) -> Any:
    """Return the triangles between neighbouring rings, outward."""
    ring = np.arange(count - 1)[:, None] * SIDES
    here, following = np.arange(SIDES), (np.arange(SIDES) + 1) % SIDES
    a, b = ring + here, ring + following
    c, d = a + SIDES, b + SIDES
    return np.stack([a, b, c, b, d, c], axis=2).reshape(-1).astype('<u4')


def glb(vertices: Any, normals: Any, colours: Any, index: Any) -> bytes:
    """Pack a mesh into one binary glTF file."""
    parts = [array.tobytes() for array in (vertices, normals, colours, index)]
    starts = np.cumsum([0] + [len(part) for part in parts])
    views = [
        {
            'buffer': 0,
            'byteOffset': int(start),
            'byteLength': len(part),
            'target': ELEMENT_BUFFER if part is parts[3] else ARRAY_BUFFER,
        }
        for start, part in zip(starts, parts, strict=False)
    ]
    accessors = [
        {
            'bufferView': 0, 'componentType': FLOAT, 'count': len(vertices), 'type': 'VEC3',
            'min': vertices.min(axis=0).tolist(), 'max': vertices.max(axis=0).tolist(),
        },
        {'bufferView': 1, 'componentType': FLOAT, 'count': len(normals), 'type': 'VEC3'},
        {
            'bufferView': 2, 'componentType': UNSIGNED_BYTE, 'normalized': True,
            'count': len(colours), 'type': 'VEC4',
        },
        {'bufferView': 3, 'componentType': UNSIGNED_INT, 'count': len(index), 'type': 'SCALAR'},
    ]  # fmt: skip
    primitive = {
        'attributes': {'POSITION': 0, 'NORMAL': 1, 'COLOR_0': 2}, 'indices': 3, 'material': 0,
    }  # fmt: skip
    document = {
        'asset': {'version': '2.0', 'generator': 'cnc_interp'},
        'scene': 0,
        'scenes': [{'nodes': [0]}],
        'nodes': [{'mesh': 0}],
        'meshes': [{'primitives': [primitive]}],
        'materials': [
            {
                'pbrMetallicRoughness': {'metallicFactor': 0.0, 'roughnessFactor': 0.9},
            }
        ],
        'buffers': [{'byteLength': int(starts[-1])}],
        'bufferViews': views,
        'accessors': accessors,
    }
    text = json.dumps(document).encode()
    text += b' ' * (-len(text) % 4)
    binary = b''.join(parts)
    binary += b'\0' * (-len(binary) % 4)
    total = 12 + 8 + len(text) + 8 + len(binary)
    return b''.join(
        [
            struct.pack('<III', MAGIC, 2, total),
            struct.pack('<II', len(text), JSON_CHUNK), text,
            struct.pack('<II', len(binary), BINARY_CHUNK), binary,
        ]
    )  # fmt: skip
