"""What an operator's hands do in a drive: lever programmes drawn at random, full of bad intent towards the limits."""

import math
from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, TypeAlias, get_args

import numpy as np

from workgauge.machine.model import MachineModel
from workgauge.motion.joystick import LeverFeel
from workgauge.proximity.scene import Scene
from workgauge.values.arrays import Floats, frozen
from workgauge.values.clearances import Clearances
from workgauge.values.limits import LimitKind
from workgauge.values.measurements import LEVER_NAMES, DriveMode, Levers, ToolLine

#: Kinds of drives.
DriveKind: TypeAlias = Literal["levers", "reversing", "sliding", "straight", "itself"]
DRIVE_KINDS: tuple[DriveKind, ...] = get_args(DriveKind)
#: How often each kind is drawn.
SHARES: dict[DriveKind, float] = {"levers": 0.2, "reversing": 0.15, "sliding": 0.35, "straight": 0.2, "itself": 0.1}
#: What is lost when the gate closes: the enable switch is let go, or an input stays away.
Lost: TypeAlias = Literal["enable", "intent", "posture", "pose"]
_LOST: tuple[Lost, ...] = get_args(Lost)
#: What a sliding drive slides along, if there is any in sight; else the nearest limit.
SLID_ALONG = LimitKind.TRACK
#: A straight drive is aimed at one of so many nearest limits.
_AIMED = 4
#: Lever combinations tried to find one along a limit.
_TRIES = 200


@dataclass(frozen=True, slots=True)
class Held:
    """Levers held until a moment of the drive.

    Attributes:
        until_s: from the drive's beginning. mode, levers, line: as in `Intent`.
    """

    until_s: float
    mode: DriveMode
    levers: Levers
    line: ToolLine | None = None


@dataclass(frozen=True, slots=True)
class Spell:
    """A time during which the gate is shut. `lost` says why."""

    from_s: float
    until_s: float
    lost: Lost


@dataclass(frozen=True, slots=True)
class Programme:
    """All the operator does in one drive, and when the gate is shut.

    Attributes:
        held: one after the other; the last is held to the end. spells: one after the other.
    """

    held: tuple[Held, ...]
    spells: tuple[Spell, ...] = ()

    def held_at(self, t_s: float) -> Held:
        """Return what is held at a moment."""
        ends = [one.until_s for one in self.held]
        return self.held[min(bisect_right(ends, t_s), len(self.held) - 1)]

    def lost_at(self, t_s: float) -> Lost | None:
        """Return what keeps the gate shut at a moment, or None."""
        return next((one.lost for one in self.spells if one.from_s <= t_s < one.until_s), None)


class Operator:
    """Draws programmes for one machine at its start posture among limits.

    Args:
        machine: whose levers. scene, T_site_machine, q: where the drive begins.
        feel: how lever positions become shares of full speed.
        sight_m: limits within this are aimed at.
    """

    def __init__(
        self,
        machine: MachineModel,
        scene: Scene,
        T_site_machine: Floats,
        q: Floats,
        feel: LeverFeel,
        sight_m: float = 6.0,
    ) -> None:
        self._machine, self._feel, self._T = machine, feel, T_site_machine
        self._kin = machine.forward(q)
        self._full = np.minimum(machine.speed_positive, machine.speed_negative)
        self._moves = np.array([name is not None for name in machine.levers])
        self._kinds = [limit.kind for limit in scene.limits]
        self._found = scene.query(self._kin, T_site_machine, sight_m)
        self._rows = machine.distance_rows(self._kin, T_site_machine, self._found)

    def programme(self, kind: DriveKind, seconds: float, gate_closes: bool, rng: np.random.Generator) -> Programme:
        """Return a programme of one kind for a drive of that length [s]."""
        held = self._opening(kind, seconds, rng)
        t = held[-1].until_s if held else 0.0
        quick = kind == "reversing"
        last = self._signs(rng)
        while t < seconds:
            t += float(rng.uniform(0.1, 0.6) if quick else rng.uniform(0.5, 2.5))
            held.append(self._joints(t, last))
            last = -last if quick and rng.random() < 0.8 else self._signs(rng)
        return Programme(tuple(held), _spells(seconds, rng) if gate_closes else ())

    def _opening(self, kind: DriveKind, seconds: float, rng: np.random.Generator) -> list[Held]:
        """Return what is done first, at the limits seen from the start posture."""
        if kind in ("levers", "reversing"):
            return []
        near = self._nearest(own=kind == "itself")
        if not near:
            return []
        if kind == "sliding":
            tracks = [i for i in near if self._kinds[int(self._found.limits[i])] == SLID_ALONG]
            return self._along(tracks[0] if tracks else near[0], seconds, rng)
        i = near[int(rng.integers(min(len(near), _AIMED)))]
        closing = -np.sign(self._rows[i]) * (np.abs(self._rows[i]) > 1e-3)
        if rng.random() < 0.5:  # not all joints that could
            kept = closing * (rng.random(len(closing)) < 0.6)
            closing = kept if kept.any() else closing
        return [self._joints(float(rng.uniform(0.4, 0.9)) * seconds, closing)]

    def _nearest(self, own: bool) -> list[int]:
        """Return the nearest clearance of every limit, or of every own link, the nearest first."""
        first: dict[int, int] = {}
        for i in np.argsort(self._found.distances, kind="stable").tolist():
            if bool(self._found.other_links[i] >= 0) == own:
                first.setdefault(int(self._found.limits[i]), i)
        return list(first.values())

    def _along(self, i: int, seconds: float, rng: np.random.Generator) -> list[Held]:
        """Return levers that lead along the limit of clearance i, pushed against it a little, to and perhaps fro."""
        draw = rng.random()
        if draw < 0.6:
            shares = self._tangent_joints(i, rng)
            there, back = (self._joints(0.0, sign * shares) for sign in (1.0, -1.0))
        else:
            direction = self._tangent(self._found, i, rng)
            there, back = (self._tool(sign * direction, line=draw > 0.8) for sign in (1.0, -1.0))
        held, t, turn = [], 0.0, False
        while t < seconds:
            t += float(rng.uniform(0.8, 2.5))
            one = back if turn else there
            held.append(Held(t, one.mode, one.levers, one.line))
            turn = not turn if rng.random() < 0.6 else turn
        return held

    def _tangent_joints(self, i: int, rng: np.random.Generator) -> Floats:
        """Return shares (n,) of full speed whose joints approach and leave the limit nearly alike, moving a lot."""
        tried = rng.choice([-1.0, -0.6, 0.0, 0.6, 1.0], (_TRIES, len(self._full))) * self._moves
        parts = tried * self._full * self._rows[i]
        moved, net = np.abs(parts).sum(axis=1), parts.sum(axis=1)
        fine = (net <= 0.05 * moved) & (net >= -0.3 * moved)
        return np.asarray(tried[int(np.argmax(np.where(fine, moved, -1.0)))])

    def _tangent(self, found: Clearances, i: int, rng: np.random.Generator) -> Floats:
        """Return a direction (3,) in the site along the limit's face, leaning towards it a little."""
        normal = found.normals[i]
        axis = rng.normal(size=3) * (1.0, 1.0, 0.3)
        along = axis - (axis @ normal) * normal
        length = float(np.linalg.norm(along))
        if length < 1e-6:
            return frozen(-normal)
        leaning = along / length - float(rng.uniform(0.0, 0.4)) * normal
        return np.asarray(leaning / np.linalg.norm(leaning), dtype=np.float64)

    def _tool(self, direction: Floats, line: bool) -> Held:
        """Return levers that move the tool that way (3,), site frame, along a line or by the machine's axes."""
        if line:
            start = (self._T @ self._machine.tool_pose(self._kin))[:3, 3]
            return Held(0.0, DriveMode.LINE, Levers(right_y=1.0), ToolLine(frozen(start), frozen(direction)))
        x, y, z = (self._T[:3, :3].T @ direction).tolist()
        largest = max(abs(x), abs(y), abs(z))
        left_y, left_x, right_y = (self._lever(share / largest) for share in (x, -y, -z))
        return Held(0.0, DriveMode.TOOL, Levers(left_x=left_x, left_y=left_y, right_y=right_y))

    def _joints(self, until_s: float, shares: Floats) -> Held:
        """Return the levers for shares (n,) of full joint speed, -1 to 1."""
        values = dict.fromkeys(LEVER_NAMES, 0.0)
        for name, sign, share in zip(
            self._machine.levers, self._machine.lever_signs.tolist(), shares.tolist(), strict=True
        ):
            if name is not None and share:
                values[name] = self._lever(sign * share)
        return Held(until_s, DriveMode.JOINT, Levers(**values))

    def _lever(self, share: float) -> float:
        """Return the lever position that gives a share of full speed, both -1 to 1."""
        if not share:
            return 0.0
        zone = self._feel.dead_zone
        position = zone + (1.0 - zone) * min(abs(share), 1.0) ** (1.0 / self._feel.exponent)
        return math.copysign(min(position, 1.0), share)

    def _signs(self, rng: np.random.Generator) -> Floats:
        """Return full levers (n,), -1, 0 or 1, of several joints at once."""
        n = len(self._full)
        return np.asarray(rng.choice([-1.0, 1.0], n) * (rng.random(n) < 0.6) * self._moves)


def drawn_kind(rng: np.random.Generator, kinds: Sequence[DriveKind] = DRIVE_KINDS) -> DriveKind:
    """Return a kind of drive, drawn in the proportions of `SHARES` among those wanted."""
    shares = np.array([SHARES[kind] for kind in kinds])
    return kinds[int(np.searchsorted(np.cumsum(shares / shares.sum()), rng.random(), side="right"))]


def _spells(seconds: float, rng: np.random.Generator) -> tuple[Spell, ...]:
    """Return one to three times at which the gate closes, at random instants."""
    spells, t = [], 0.0
    for _ in range(int(rng.integers(1, 4))):
        t += float(rng.uniform(0.15, 0.6)) * seconds
        until = t + float(rng.uniform(0.05, 0.5))
        spells.append(Spell(t, until, _LOST[int(rng.integers(len(_LOST)))]))
        t = until
    return tuple(spells)
