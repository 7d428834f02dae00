"""What is read of a STEP file: the chosen faces as surfaces, and points of all faces."""

from __future__ import annotations

from dataclasses import dataclass

from cnc_interp.cam.neighbours import Neighbours
from cnc_interp.cam.surface import Surface


@dataclass(frozen=True)
class Part:
    """
    Faces to machine, and the other faces of the part.

    Parameters
    ----------
    surfaces : dict of int to Surface
        Surfaces by the number of their face, in the order in which they are machined.
    neighbours : Neighbours, optional
        Points of all faces, also of those that are machined; none for a single face.

    """

    surfaces: dict[int, Surface]
    neighbours: Neighbours | None = None
