"""Surfaces that are turned and moved."""

from __future__ import annotations

from cnc_interp.cam.surface import Domain, Surface
from cnc_interp.core.arrays import BoolArray, FloatArray


class Placed(Surface):
    """A surface that is turned and moved, as on a fixture."""

    def __init__(
        self, surface: Surface, rotation: FloatArray, shift: FloatArray,
        domain: Domain | None = None, flip: bool = False,
    ):  # fmt: skip
        super().__init__(domain or surface.domain)
        self.surface, self.rotation, self.shift = surface, rotation, shift
        self.sign = -surface.sign if flip else surface.sign

    def derivatives(self, u: FloatArray, v: FloatArray) -> tuple[FloatArray, ...]:
        """Return the position and its first and second derivatives."""
        first, *others = (x @ self.rotation.T for x in self.surface.derivatives(u, v))
        return (first + self.shift, *others)

    def contains(self, u: FloatArray, v: FloatArray, margin: float = 0.0) -> BoolArray:
        """Tell which points lie on the machined part, or no further than a margin outside."""
        if self.domain == self.surface.domain:
            return self.surface.contains(u, v, margin)
        return super().contains(u, v, margin)
