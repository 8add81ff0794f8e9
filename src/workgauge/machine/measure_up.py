"""Measuring up an attachment: where its tool centre point sits on the last link, from measured positions of its tip.

With the last link's frame `(R_i, o_i)` at posture i in the machine frame, the tip x (in that frame) and its measured
place p_i:

    known places:    R_i x = p_i - o_i + e_i            the tip surveyed, or touching known points
    one same point:  R_i x - c = -o_i + e_i             touched in several postures, its place c unknown

Linear in x (and c), so least squares gives both at once. Each e_i has the survey's variance and what the joint
sensors add at the tip, `J_i S_q J_i^T`; J_i depends on x, hence a second pass. The covariance is scaled up, never
down, by the residuals (a posteriori variance factor).
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from workgauge.machine.model import Kinematics, MachineModel
from workgauge.values.arrays import Floats, frozen
from workgauge.values.errors import MachineError

#: Fewer touches than this leave nothing to judge them by.
FEWEST_KNOWN, FEWEST_SAME = 3, 4

#: The last link must turn by this much between two of the postures: an error of a joint would hide otherwise [rad].
LEAST_TURN = math.radians(10.0)

#: With one same point: 1-sigma of the tip over that of a touch, at most. Turning about one axis only, it is infinite.
LARGEST_DILUTION = 10.0

#: A residual beyond so many sigma is a blunder.
BLUNDER_SIGMAS = 5.0


@dataclass(frozen=True, slots=True, eq=False)
class Touch:
    """One measurement: joint positions q (n,) [rad, m] and the tip's place (3,) in the machine frame [m].

    `point` is None where all touches are of one same point whose place nobody knows.
    """

    q: Floats
    point: Floats | None = None


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredUp:
    """A measured-up tool centre point.

    Attributes:
        position: (3,) in the last link's frame [m]. covariance: (3, 3) of that [m^2].
        residuals: (k, 3) measured less adjusted place of each touch, machine frame [m]. rms_m: of their lengths.
        tolerance_m: 1-sigma of the position in its worst direction: the attachment's `tolerance_m`.
        dilution: what the choice of postures alone makes of a touch's error, 1-sigma over 1-sigma.
        factor: a posteriori over a priori 1-sigma of a touch. redundancy: measurements less unknowns.
    """

    position: Floats
    covariance: Floats
    residuals: Floats
    rms_m: float
    tolerance_m: float
    dilution: float
    factor: float
    redundancy: int


def measure_up(
    machine: MachineModel, touches: Sequence[Touch], sigma_m: float, joint_sigma: Floats | None = None
) -> MeasuredUp:
    """Return the tool centre point that fits the touches best.

    Args:
        machine: with any attachment mounted; its own tool is not looked at.
        touches: all with a place, or all without one.
        sigma_m: 1-sigma of a touch in each direction: survey, and how exactly the tip was on the point.
        joint_sigma: (n,) 1-sigma of the joint sensors [rad, m], None for exact ones.

    Raises:
        MachineError: for too few touches, numbers that are none, postures that cannot tell, or a blunder.
    """
    same = _same_point(touches)
    fewest = FEWEST_SAME if same else FEWEST_KNOWN
    if len(touches) < fewest:
        raise MachineError("too few touches", element="touches", value=len(touches), allowed=f"{fewest} or more")
    if not (math.isfinite(sigma_m) and sigma_m > 0.0):
        raise MachineError("a touch is never exact", element="sigma", value=sigma_m, allowed="above 0 m")
    _finite(machine, touches)
    postures = [machine.forward(touch.q) for touch in touches]
    _turned_enough(postures)
    A, b = _equations(postures, touches, same)
    dilution = _dilution(A, same)
    joints = np.zeros(machine.n) if joint_sigma is None else np.asarray(joint_sigma, dtype=np.float64)
    noise = np.tile(sigma_m**2 * np.eye(3), (len(touches), 1, 1))
    for _ in range(2):
        unknowns, C = _solve(A, b, noise)
        noise = _noise(machine, postures, unknowns[:3], joints, sigma_m)
    unknowns, C = _solve(A, b, noise)
    residuals = (b - A @ unknowns).reshape(-1, 3)
    _no_blunder(A, C, noise, residuals)
    redundancy = len(b) - len(unknowns)
    chi2 = float(np.einsum("ki,kij,kj->", residuals, np.linalg.inv(noise), residuals))
    factor = math.sqrt(chi2 / redundancy)
    covariance = C[:3, :3] * max(1.0, factor) ** 2
    return MeasuredUp(
        position=frozen(unknowns[:3]),
        covariance=frozen(covariance),
        residuals=frozen(residuals),
        rms_m=math.sqrt(float((residuals**2).sum(axis=1).mean())),
        tolerance_m=math.sqrt(float(np.linalg.eigvalsh(covariance)[-1])),
        dilution=dilution,
        factor=factor,
        redundancy=redundancy,
    )


def sensor_sigmas(machine: MachineModel) -> Floats:
    """Return the 1-sigma (n,) of each joint's sensor by the machine's positioning section; zeros without one."""
    sigmas = np.zeros(machine.n)
    for spec in () if machine.positioning is None else machine.positioning.joints:
        j = machine.joint_names.index(spec.joint)
        if machine.prismatic[j]:
            sigmas[j] = spec.sigma_m or 0.0
        else:
            sigmas[j] = math.radians(0.1 if spec.sigma_deg is None else spec.sigma_deg)
    return frozen(sigmas)


def attachment_entry(
    name: str, measured: MeasuredUp, touches: int, like: Mapping[str, Any] | None = None
) -> dict[str, Any]:
    """Return the entry of a machine file for a measured-up attachment, ready to be written as YAML.

    Lengths are rounded to a tenth of a millimetre, the tolerance upwards. Everything but the tool's position and
    tolerance is taken from `like`, the entry there was, if any.
    """
    entry = dict(like or {})
    tool = {**(entry.get("tool") or {}), "position_m": [round(float(v), 4) + 0.0 for v in measured.position]}
    source = (
        f"tool centre point measured up by {touches} touches: residuals {1e3 * measured.rms_m:.1f} mm rms, "
        f"{measured.factor:.1f} times what was expected"
    )
    tolerance = math.ceil(measured.tolerance_m * 1e4) / 1e4
    return {**entry, "name": name, "tool": tool, "tolerance_m": tolerance, "source": source}


def _same_point(touches: Sequence[Touch]) -> bool:
    given = sum(touch.point is not None for touch in touches)
    if given not in (0, len(touches)):
        raise MachineError(
            "some touches have a place and some have none",
            element="touches",
            value=f"{given} of {len(touches)}",
            allowed="a place for each, or for none",
        )
    return given == 0


def _finite(machine: MachineModel, touches: Sequence[Touch]) -> None:
    for i, touch in enumerate(touches):
        numbers = [*np.ravel(touch.q).tolist(), *(np.ravel(touch.point).tolist() if touch.point is not None else ())]
        if np.shape(touch.q) != (machine.n,) or not all(math.isfinite(v) and abs(v) < 1e6 for v in numbers):
            raise MachineError(
                "not a posture and a place", element=f"touch {i + 1}", value=numbers, allowed="finite numbers"
            )


def _turned_enough(postures: Sequence[Kinematics]) -> None:
    """Refuse postures in which the last link hangs alike."""
    turns = np.array([kin.T_machine_links[-1, :3, :3] for kin in postures])
    cosines = (np.einsum("aij,bij->ab", turns, turns) - 1.0) / 2.0
    largest = float(np.arccos(np.clip(cosines.min(), -1.0, 1.0)))
    if largest < LEAST_TURN:
        raise MachineError(
            "the postures are too alike: an error of a joint sensor would go into the tool unseen",
            element="touches",
            value=f"the last link turns by {math.degrees(largest):.1f}°",
            allowed=f"{math.degrees(LEAST_TURN):g}° or more between two of them",
        )


def _equations(postures: Sequence[Kinematics], touches: Sequence[Touch], same: bool) -> tuple[Floats, Floats]:
    """Return A (3k, 3 or 6) and b (3k,) of `A (x, c) = b`."""
    rows, right = [], []
    for kin, touch in zip(postures, touches, strict=True):
        T = kin.T_machine_links[-1]
        rows.append(np.hstack([T[:3, :3], -np.eye(3)]) if same else T[:3, :3])
        right.append((0.0 if touch.point is None else touch.point) - T[:3, 3])
    return np.vstack(rows), np.concatenate(right)


def _dilution(A: Floats, same: bool) -> float:
    """Return the tip's worst 1-sigma for touches of 1-sigma 1; refuse what does not determine it."""
    values = np.linalg.eigvalsh(A.T @ A)
    if values[0] > 1e-9 * values[-1]:
        spread = np.linalg.inv(A.T @ A)[:3, :3]
        dilution = math.sqrt(float(np.linalg.eigvalsh(spread)[-1]))
    else:
        dilution = math.inf
    if same and dilution > LARGEST_DILUTION:
        raise MachineError(
            "the postures cannot tell where the tip is: turn the attachment about another axis too (tilt, rotate)",
            element="touches",
            value=f"an error of a touch grows {dilution:.3g} times",
            allowed=f"{LARGEST_DILUTION:g} times",
        )
    return dilution


def _solve(A: Floats, b: Floats, noise: Floats) -> tuple[Floats, Floats]:
    """Return the unknowns and their covariance, each touch weighted by the inverse of its own (k, 3, 3)."""
    weights = np.linalg.inv(noise)
    columns = A.reshape(len(noise), 3, -1)
    C = np.linalg.inv(np.einsum("kia,kij,kjb->ab", columns, weights, columns))
    return C @ np.einsum("kia,kij,kj->a", columns, weights, b.reshape(-1, 3)), C


def _noise(
    machine: MachineModel, postures: Sequence[Kinematics], x: Floats, joint_sigma: Floats, sigma_m: float
) -> Floats:
    """Return the covariance (k, 3, 3) of each touch: survey, and the joint sensors at the tip."""
    out = []
    for kin in postures:
        T = kin.T_machine_links[-1]
        tip = T[:3, :3] @ x + T[:3, 3]
        J = machine.point_jacobians(kin, [machine.tool_link], [tip])[0]
        out.append(sigma_m**2 * np.eye(3) + (J * joint_sigma**2) @ J.T)
    return np.array(out)


def _no_blunder(A: Floats, C: Floats, noise: Floats, residuals: Floats) -> None:
    """Refuse a touch whose residual no honest error explains, naming the worst."""
    columns = A.reshape(len(noise), 3, -1)
    spread = noise - columns @ C @ columns.transpose(0, 2, 1)
    worst, by = -1, BLUNDER_SIGMAS
    for i, (r, S) in enumerate(zip(residuals, spread, strict=True)):
        values, axes = np.linalg.eigh(S)
        free = values > 1e-3 * float(np.trace(noise[i]))  # directions that other touches say something of
        along = (axes.T @ r)[free]
        size = math.sqrt(float((along**2 / values[free]).sum()))
        if size > by:
            worst, by = i, size
    if worst >= 0:
        raise MachineError(
            "this touch does not fit the others: measure it again, or leave it out",
            element=f"touch {worst + 1}",
            value=f"{1e3 * float(np.linalg.norm(residuals[worst])):.0f} mm off, {by:.1f} sigma",
            allowed=f"{BLUNDER_SIGMAS:g} sigma",
        )
