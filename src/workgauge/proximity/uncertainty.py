"""What is not sure about a machine and about the limits around it, gathered for `protection`."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from workgauge.values.arrays import Floats, Ints, freeze, frozen, frozen_ints
from workgauge.values.limits import Limit
from workgauge.values.solids import Box, Convex, PrismChain, Solid, Surface, Tube


@dataclass(frozen=True, slots=True, eq=False)
class MachineUncertainty:
    """Errors of a machine's pose and joints at one tick: zero mean, Gaussian.

    Attributes:
        covariance: (6 + n, 6 + n) of (translation, rotation vector, joints): the true pose is
            `(t + translation, Exp(rotation) R)` of the believed (t, R), site frame, the true joints are believed plus
            error [m, rad].
        tool_sigma_m: 1-sigma of where the attachment sits on its link, along any direction [m].
        correlated: whether errors of the joints depend on each other or on the pose's.
        exact: whether the covariance is zero.
    """

    covariance: Floats
    tool_sigma_m: float
    correlated: bool
    exact: bool

    @classmethod
    def of(
        cls,
        pose_covariance: Floats,
        joint_sigma: Floats,
        *,
        tool_sigma_m: float = 0.0,
        cross: Floats | None = None,
        joint_covariance: Floats | None = None,
    ) -> "MachineUncertainty":
        """Return the uncertainty of a pose and a posture.

        Args:
            pose_covariance: (6, 6), as in `MachinePose`. joint_sigma: (n,), as in `Posture` [rad, m].
            tool_sigma_m: of the attachment, as in `MachineModel.tool_tolerance_m` [m].
            cross: (6, n) covariance of pose and joints, or None if they are independent.
            joint_covariance: (n, n), instead of the squares of joint_sigma, or None if joints are independent.
        """
        n = len(joint_sigma)
        whole = np.zeros((6 + n, 6 + n))
        whole[:6, :6] = pose_covariance
        if joint_covariance is None:
            whole.reshape(-1)[6 * (7 + n) :: 7 + n] = joint_sigma * joint_sigma
        else:
            whole[6:, 6:] = joint_covariance
        if cross is not None:
            whole[:6, 6:] = cross
            whole[6:, :6] = cross.T
        freeze(whole)
        return cls(
            whole, tool_sigma_m, cross is not None or joint_covariance is not None, not np.count_nonzero(whole)
        )


@dataclass(frozen=True, slots=True, eq=False)
class LimitUncertainty:
    """What is not sure about the limits of a scene and, by the same index, the machine's own links.

    A limit whose pose is uncertain moves by the translation and turns by the rotation of its covariance about its own
    place: the mean of the points that define its solid (the centre of a box; the mean of a chain's axis points, of a
    mesh's vertices). Pose errors of different limits and of the machine are independent of each other.

    Attributes:
        variances: (m,) squared 1-sigma tolerances along any direction [m^2], 0 for links.
        largest_variance: the largest of them [m^2].
        poses: (m,) index into places and covariances, -1 for a limit whose pose is sure.
        places: (u, 3), what uncertain limits turn about. covariances: (u, 6, 6) of (translation, rotation vector).
    """

    variances: Floats
    largest_variance: float
    poses: Ints
    places: Floats
    covariances: Floats

    @classmethod
    def of(cls, limits: Sequence[Limit], links: int = 0) -> "LimitUncertainty":
        """Return the uncertainty of limits, followed by that many links of the machine."""
        variances = [*(limit.tolerance_m**2 for limit in limits), *(0.0 for _ in range(links))]
        unsure = [i for i, limit in enumerate(limits) if limit.covariance.any()]
        poses = np.full(len(variances), -1)
        poses[unsure] = np.arange(len(unsure))
        return cls(
            frozen(variances),
            max(variances, default=0.0),
            frozen_ints(poses),
            frozen(np.reshape([own_place(limits[i].solid) for i in unsure], (-1, 3))),
            frozen(np.reshape([limits[i].covariance for i in unsure], (-1, 6, 6))),
        )


def own_place(solid: Solid) -> Floats:
    """Return the place (3,) about which a limit of this solid turns if its pose is uncertain."""
    match solid:
        case Box():
            return frozen(solid.T_frame_box[:3, 3])
        case Convex() | Surface():
            return frozen(solid.vertices.mean(axis=0))
        case PrismChain():
            return frozen(0.5 * (solid.starts.mean(axis=0) + solid.ends.mean(axis=0)))
        case Tube():
            return frozen(solid.axis.mean(axis=0))
