"""Which pairs of a machine's own solids can come near each other."""

import itertools

import numpy as np

from workgauge.machine.model import MachineModel
from workgauge.machine.parts import SkippedPair
from workgauge.values.arrays import Floats

#: Pairs of links that are not neighbours are checked if they can come this near [m].
NEAR_M = 1.0
#: Neighbours are checked only if they can touch: this near [m].
TOUCH_M = 0.02
#: Postures looked at, besides the corners of the joint limits.
POSTURES = 3000

Pairs = tuple[tuple[int, int], ...]


def find_self_pairs(
    machine: MachineModel, allowed_contacts: frozenset[frozenset[str]]
) -> tuple[Pairs, tuple[SkippedPair, ...]]:
    """Return the pairs of solids (i < j) to be kept apart, and the others on different links with the reason.

    Left out are pairs of one link, allowed contacts, pairs whose boxes overlap in the home posture or in every
    posture (neighbours share a pin), neighbours that never touch (a cabin turning above its undercarriage keeps its
    distance), and pairs that never come within `NEAR_M`. Neighbours are links with no solid-carrying link between
    them. Postures are the limits' corners and a fixed low-discrepancy sequence, so the answer is always the same. The
    distance used is a lower bound (separating axes): a pair is rather kept than dropped.
    """
    links = [solid.link for solid in machine.solids]
    carrying = sorted(set(links))
    poses, halves = _sampled_solids(machine)
    kept, skipped = [], []
    for i, j in itertools.combinations(range(len(links)), 2):
        if links[i] == links[j]:
            continue
        gaps = _gaps(poses[:, i], halves[:, i], poses[:, j], halves[:, j])
        neighbours = abs(carrying.index(links[i]) - carrying.index(links[j])) == 1
        names = (machine.solids[i].name, machine.solids[j].name)
        nearest = float(gaps.min())
        if frozenset(names) in allowed_contacts:
            why = "allowed contact"
        elif gaps[0] <= 0.0:
            why = "overlap in the home posture"
        elif float(gaps.max()) <= 0.0:
            why = "overlap in every posture"
        elif neighbours and nearest > TOUCH_M:
            why = "neighbours that never touch"
        elif nearest > NEAR_M:
            why = f"never nearer than {nearest:.1f} m"
        else:
            kept.append((i, j))
            continue
        skipped.append(SkippedPair(*names, why))
    return tuple(kept), tuple(skipped)


def postures(machine: MachineModel, count: int) -> Floats:
    """Return (m, n) postures: home, the corners of the limits, then an additive low-discrepancy sequence."""
    lower, upper = machine.sample_min, machine.sample_max
    corners = [machine.home]
    if machine.n <= 8:
        corners += [np.where(bits, upper, lower) for bits in itertools.product((False, True), repeat=machine.n)]
    ratio = 2.0
    for _ in range(40):  # the root of x^(n+1) = x + 1, whose powers fill the cube evenly
        ratio = (1.0 + ratio) ** (1.0 / (machine.n + 1))
    steps = ratio ** -np.arange(1.0, machine.n + 1)
    unit = (0.5 + np.arange(1, count + 1)[:, None] * steps) % 1.0
    return np.concatenate([np.array(corners), lower + unit * (upper - lower)])


def _sampled_solids(machine: MachineModel) -> tuple[Floats, Floats]:
    poses, halves = [], []
    for q in postures(machine, POSTURES):
        pose, half = machine.solid_poses(machine.forward(q))
        poses.append(pose)
        halves.append(half)
    return np.array(poses), np.array(halves)


def _gaps(first: Floats, first_halves: Floats, second: Floats, second_halves: Floats) -> Floats:
    """Return lower bounds (m,) of the distances between boxes, negative only if they overlap (separating axes)."""
    A = first[:, :3, :3].transpose(0, 2, 1)  # rows are the box's axes
    B = second[:, :3, :3].transpose(0, 2, 1)
    crossed = np.cross(A[:, :, None], B[:, None]).reshape(len(A), 9, 3)
    lengths = np.linalg.norm(crossed, axis=-1)
    degenerate = lengths < 1e-6
    crossed /= np.where(degenerate, 1.0, lengths)[..., None]
    axes = np.concatenate([A, B, crossed], axis=1)
    between = np.abs(np.matvec(axes, second[:, :3, 3] - first[:, :3, 3]))
    reach = np.matvec(np.abs(axes @ first[:, :3, :3]), first_halves)
    reach += np.matvec(np.abs(axes @ second[:, :3, :3]), second_halves)
    gaps = between - reach
    gaps[:, 6:][degenerate] = -np.inf
    found: Floats = gaps.max(axis=1)
    return found
