"""What is read of a STEP file: the chosen faces as surfaces, and points of all faces."""

from __future__ import annotations

from dataclasses import dataclass

from cnc_interp.cam.neighbours import Neighbours
from cnc_interp.cam.surface import Surface


@dataclass(frozen=True)
class Part:
    """Faces to machine, and the other faces of the part."""

    #: Surfaces by the number of their face, in the order in which they are machined.
    surfaces: dict[int, Surface]
    #: Points of all faces, also of those that are machined; none for a single face.
    neighbours: Neighbours | None = None
