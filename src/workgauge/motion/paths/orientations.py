"""How a tool's orientation goes over from one given orientation to the next along a path."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from scipy.spatial.transform import Rotation, RotationSpline

from workgauge.values.arrays import Floats, Ints, frozen

#: Degree of the curves of a path's pieces.
DEGREE = 5
_BINOMIALS = {
    3: np.array([1.0, 3.0, 3.0, 1.0]),
    4: np.array([1.0, 4.0, 6.0, 4.0, 1.0]),
    5: np.array([1.0, 5.0, 10.0, 10.0, 5.0, 1.0]),
}


def bernstein(t: Floats, degree: int) -> Floats:
    """Return the Bernstein polynomials (..., degree + 1) at t (...) in [0, 1], degree 3 to 5."""
    powers = np.arange(degree + 1)
    at = t[..., None]
    basis: Floats = _BINOMIALS[degree] * at**powers * (1.0 - at) ** powers[::-1]
    return basis


class Turning(Protocol):
    """An orientation along a path made of pieces."""

    def at(self, s: Floats, piece: Ints, t: Floats, per_m: Floats) -> tuple[Floats, Floats]:
        """Return rotations (N, 3, 3) site from tool and their rate (N, 3) [rad/m], in the site's axes.

        Args:
            s: (N,) distances [m]. piece: (N,) and t: (N,), the piece each lies on and the place on it, 0 to 1.
            per_m: (N,) dt/ds [1/m].
        """


@dataclass(frozen=True, slots=True)
class Unturned:
    """No orientation: the identity everywhere."""

    def at(self, s: Floats, piece: Ints, t: Floats, per_m: Floats) -> tuple[Floats, Floats]:
        """Return identities (N, 3, 3) and zeros (N, 3)."""
        return np.tile(np.eye(3), (len(s), 1, 1)), np.zeros((len(s), 3))


@dataclass(frozen=True, slots=True, eq=False)
class BlendedTurning:
    """Bézier curves of rotations in cumulative form, `R = R0 exp(B1 w1) ... exp(B5 w5)`.

    `wi` is the rotation vector from control i - 1 to control i, `Bi` the sum of the Bernstein polynomials from i up
    (Kim, Kim and Shin 1995). Controls evenly spaced on a great arc give slerp itself; a piece whose outer three
    controls on each side lie so on the arcs beside it joins them without a step in rate or in its derivative.

    Attributes:
        first: (m, 3, 3) control 0 of each piece. steps: (m, 5, 3) the rotation vectors [rad].
    """

    first: Floats
    steps: Floats

    @classmethod
    def through(cls, controls: Floats) -> "BlendedTurning":
        """Return the curves of control rotations (m, 6, 3, 3)."""
        between = np.swapaxes(controls[:, :-1], -1, -2) @ controls[:, 1:]
        return cls(frozen(controls[:, 0]), frozen(rotation_vectors(between)))

    def at(self, s: Floats, piece: Ints, t: Floats, per_m: Floats) -> tuple[Floats, Floats]:
        """Return rotations (N, 3, 3) and their rate (N, 3) [rad/m]; see `Turning`."""
        shares = np.cumsum(bernstein(t, DEGREE)[:, ::-1], axis=1)[:, ::-1]
        rates = DEGREE * bernstein(t, DEGREE - 1) * per_m[:, None]
        R, omega = self.first[piece], np.zeros((len(t), 3))
        for i in range(DEGREE):
            step = self.steps[piece, i]
            omega += np.einsum("nij,nj->ni", R, step) * rates[:, i, None]
            R = R @ rotations(step * shares[:, i + 1, None])
        return R, omega


@dataclass(frozen=True, slots=True, eq=False)
class SplineTurning:
    """A spline of rotations by distance: rate and acceleration of turning are continuous."""

    spline: RotationSpline

    @classmethod
    def through(cls, distances: Floats, R: Floats) -> "SplineTurning":
        """Return the spline through rotations (k, 3, 3) at growing distances (k,) [m]."""
        return cls(RotationSpline(distances, Rotation.from_matrix(R)))

    def at(self, s: Floats, piece: Ints, t: Floats, per_m: Floats) -> tuple[Floats, Floats]:
        """Return rotations (N, 3, 3) and their rate (N, 3) [rad/m]; see `Turning`."""
        R = self.spline(s).as_matrix()
        return R, np.einsum("nij,nj->ni", R, self.spline(s, 1))  # the spline's own rate is in the tool's axes


def rotation_vectors(R: Floats) -> Floats:
    """Return the rotation vectors (..., 3) [rad] of rotations (..., 3, 3)."""
    flat = Rotation.from_matrix(R.reshape(-1, 3, 3)).as_rotvec()
    return np.asarray(flat.reshape(*R.shape[:-2], 3), dtype=np.float64)


def rotations(vectors: Floats) -> Floats:
    """Return the rotations (..., 3, 3) of rotation vectors (..., 3) [rad]."""
    flat = Rotation.from_rotvec(vectors.reshape(-1, 3)).as_matrix()
    return np.asarray(flat.reshape(*vectors.shape[:-1], 3, 3), dtype=np.float64)


def angles(R: Floats) -> Floats:
    """Return the angles (...) [rad] of rotations (..., 3, 3), at most pi."""
    return np.asarray(np.linalg.norm(rotation_vectors(R), axis=-1), dtype=np.float64)
