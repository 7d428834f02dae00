"""Surfaces that are turned and moved."""

from __future__ import annotations

from cnc_interp.cam.surface import Domain, Surface
from cnc_interp.core.arrays import BoolArray, FloatArray


class Placed(Surface):
    """
    A surface that is turned and moved, as on a fixture.

    Parameters
    ----------
    surface : Surface
        The surface in its own frame.
    rotation : ndarray, shape (3, 3)
        Rotation from its own frame [-].
    shift : ndarray, shape (3,)
        Translation after the rotation [m].
    domain : ((float, float), (float, float)), optional
        Ranges of u and v, if they differ from those of the surface.
    flip : bool
        Reverse the normal.

    """

    def __init__(
        self, surface: Surface, rotation: FloatArray, shift: FloatArray,
        domain: Domain | None = None, flip: bool = False,
    ):  # fmt: skip
        super().__init__(domain or surface.domain)
        self.surface, self.rotation, self.shift = surface, rotation, shift
        self.sign = -surface.sign if flip else surface.sign

    def derivatives(self, u: FloatArray, v: FloatArray) -> tuple[FloatArray, ...]:
        """
        Return the position and its first and second derivatives.

        Parameters
        ----------
        u, v : ndarray, shape (...)
            Parameters of the surface [units of u and v].

        Returns
        -------
        tuple of ndarray, shape (..., 3)
            S, S_u, S_v, S_uu, S_uv and S_vv [m per units of u and v].

        """
        first, *others = (x @ self.rotation.T for x in self.surface.derivatives(u, v))
        return (first + self.shift, *others)

    def contains(self, u: FloatArray, v: FloatArray, margin: float = 0.0) -> BoolArray:
        """
        Tell which points lie on the part that is machined, or no further than a margin outside.

        Parameters
        ----------
        u, v : ndarray, shape (...)
            Parameters of the surface [units of u and v].
        margin : float
            Distance on the surface [m].

        Returns
        -------
        ndarray of bool, shape (...)

        """
        if self.domain == self.surface.domain:
            return self.surface.contains(u, v, margin)
        return super().contains(u, v, margin)
