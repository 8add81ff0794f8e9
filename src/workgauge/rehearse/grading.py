"""Work on a surface: the lines asked for in plan, the ways the bucket takes on them, its strokes pass by pass."""

import itertools
import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from workgauge.machine.model import MachineModel
from workgauge.motion.bucket.edge import Bucket
from workgauge.motion.bucket.strokes import CutPace, Stroke, passes, stroke
from workgauge.motion.bucket.surface_path import Blend
from workgauge.motion.bucket.ways import Way, at_height, default_reach, swing_axis, ways
from workgauge.motion.planning import Pace
from workgauge.rehearse.auto_steps import GradeSurface
from workgauge.site.model import SiteModel
from workgauge.site.surface.lines import beside, fan, side_by_side, towards, within_ring
from workgauge.site.surface.tin import Tin
from workgauge.values.arrays import Floats
from workgauge.values.errors import InputError, ScenarioError

#: Heights of two surfaces at one place in this ratio, nearly, are taken for metres and feet.
_FEET, _NEARLY = 3.28084, 0.01


@dataclass(frozen=True, slots=True)
class Lines:
    """Which lines, in plan. Exactly one of the first four; see `GradeSurface` for what they are.

    Attributes:
        count, spacing_m: side by side. yaws: of a fan, seen from the machine [rad].
        alignment, offset_m: beside it. polyline: (p, 2) absolute.
        near_m, far_m: from the swing axis, None for what the machine reaches.
    """

    count: int | None = None
    spacing_m: float = 1.0
    yaws: tuple[float, ...] | None = None
    alignment: str | None = None
    offset_m: float = 0.0
    polyline: Floats | None = None
    near_m: float | None = None
    far_m: float | None = None

    @classmethod
    def of(cls, step: GradeSurface) -> "Lines":
        """Return those of a step."""
        near, far = step.near_m, step.far_m
        if step.side_by_side is not None:
            return cls(count=step.side_by_side.count, spacing_m=step.side_by_side.spacing_m, near_m=near, far_m=far)
        if step.fan is not None:
            yaws = np.radians(np.linspace(step.fan.from_deg, step.fan.to_deg, step.fan.count))
            return cls(yaws=tuple(yaws.tolist()), near_m=near, far_m=far)
        if step.along is not None:
            return cls(alignment=step.along.alignment, offset_m=step.along.offset_m, near_m=near, far_m=far)
        return cls(polyline=np.array(step.polyline_en_m, dtype=np.float64), near_m=near, far_m=far)

    def in_plan(self, site: SiteModel, machine: MachineModel, T_absolute_machine: Floats) -> list[Floats]:
        """Return the lines (p, 2 each), absolute [m], as far as the machine may reach them.

        Raises:
            InputError: there are none, or no such alignment.
        """
        near, far = default_reach(machine)
        near, far = near if self.near_m is None else self.near_m, far if self.far_m is None else self.far_m
        centre = swing_axis(machine, T_absolute_machine)
        yaw = math.atan2(T_absolute_machine[1, 0], T_absolute_machine[0, 0])
        if self.count is not None:
            return side_by_side(centre, yaw, near, far, self.count, self.spacing_m)
        if self.yaws is not None:
            return fan(centre, [yaw + one for one in self.yaws], near, far)
        if self.alignment is not None:
            alignment = site.alignment(self.alignment)
            along = float(alignment.project(centre[None])[0][0])
            line = beside(alignment, self.offset_m, along - 2.0 * far, along + 2.0 * far)
        else:
            assert self.polyline is not None
            line = self.polyline
        parts = within_ring(line, centre, near, far)
        if not parts:
            raise InputError(
                "no part of the line is within reach",
                element="line",
                value=f"{_nearest(line, centre):.1f} m away at its nearest",
                allowed=f"{near:.2f} to {far:.2f} m from the swing axis",
            )
        # as it is given a user's line keeps its direction; others run towards the machine
        return parts if self.polyline is not None else [towards(part, centre) for part in parts]


def _nearest(line: Floats, centre: Floats) -> float:
    t = np.linspace(0.0, 1.0, 50)[:, None]
    dense = np.concatenate([a + t * (b - a) for a, b in itertools.pairwise(line)])
    return float(np.linalg.norm(dense - centre, axis=1).min())


class Grading:
    """A site's surfaces, for a machine to work on.

    Args:
        site: with the surfaces. origin: (3,) of the site's local frame, absolute.
    """

    def __init__(self, site: SiteModel, origin: Floats) -> None:
        self._site, self._origin = site, origin
        self._tins: dict[str | None, Tin] = {}

    def tin(self, name: str | None) -> Tin:
        """Return a surface by name, or all of them as one.

        Raises:
            InputError: there is none of that name, or none at all.
        """
        if name not in self._tins:
            found = [s for s in self._site.surfaces if name is None or s.name.strip() == name.strip()]
            if not found:
                known = ", ".join(repr(s.name) for s in self._site.surfaces) or "none, the site has no surface"
                raise InputError("no such surface", element="surface", value=name, allowed=known)
            self._tins[name] = Tin.of_all(found)
        return self._tins[name]

    @cached_property
    def doubts(self) -> tuple[str, ...]:
        """What is to be said of the surfaces together: heights in feet beside heights in metres."""
        heights = [(s.name, float(np.median(s.vertices[:, 2]))) for s in self._site.surfaces]
        said = []
        for i, (one, low) in enumerate(heights):
            for other, high in heights[i + 1 :]:
                ratio = max(abs(low), abs(high)) / max(min(abs(low), abs(high)), 1e-9)
                if abs(ratio / _FEET - 1.0) < _NEARLY:
                    said.append(
                        f"heights of {one!r} and {other!r} differ as metres and feet do: {low:.1f}, {high:.1f}"
                    )
        return tuple(said)

    def ways(
        self, name: str | None, lines: Lines, machine: MachineModel, T: Floats, bucket: Bucket, blend: Blend
    ) -> tuple[list[Way], list[str]]:
        """Return the ways of lines on a surface, and what is to be said of them.

        Args:
            T: (4, 4) machine in the site's local frame.
        """
        tin = self.tin(name)
        absolute = np.array(T)
        absolute[:3, 3] += self._origin
        plan = lines.in_plan(self._site, machine, absolute)
        found, said = ways(tin, plan, machine, T, self._origin, bucket, blend)
        return found, [*tin.findings.words(tin.name), *self.doubts, *said]

    def strokes(
        self, step: GradeSurface, machine: MachineModel, q: Floats, T: Floats
    ) -> tuple[list[Stroke], tuple[str, ...]]:
        """Return the strokes of a step, from the posture q (n,), and what is to be said of them.

        Raises:
            InputError: no way of it is in reach.
        """
        bucket = Bucket(step.bucket_width_m, math.radians(step.cutting_deg))
        # the room above the surface is left where the edge's ends bind as well, not only where its middle does
        deepest_mm = max(step.over_dig_mm - step.above_mm, 0.0)
        blend = Blend(step.turn_m, step.corner_mm * 1e-3, deepest_mm * 1e-3)
        found, said = self.ways(step.surface, Lines.of(step), machine, T, bucket, blend)
        inside = [way for way in found if way.joints is not None]
        if not inside:
            value = "; ".join(said) or None
            raise ScenarioError("no way of the bucket is in reach", element="grade", value=value)
        ground = None if step.ground is None else self.tin(step.ground)
        turn = None if step.turn_deg_s is None else math.radians(step.turn_deg_s)
        pace = CutPace(step.speed_m_s, Pace(step.move_m_s, turn, step.share))
        strokes: list[Stroke] = []
        for way in inside:
            for k, offset in enumerate(passes(ground, way.made, step.depth_m, self._origin)):
                raised = offset + step.above_mm * 1e-3
                words = f"cut {way.line}" if not k and offset == 0.0 else f"cut {way.line}, pass {k + 1}"
                made_all, left = at_height(self.tin(step.surface), way, machine, T, self._origin, blend, raised)
                if left > 0.05:
                    said.append(f"{words}: {left:.2f} m are out of reach so high and left out")
                for made in made_all:
                    done = stroke(machine, T, q, made, pace, lift_m=step.lift_m, words=words)
                    strokes.append(done)
                    q = done.q_end
        worst = max((one.error.corner_m for one in strokes), default=0.0)
        if worst > 1e-3:
            said.append(
                f"the machine cannot turn the edge as the surface lies: its ends are off by up to {worst:.3f} m"
            )
        return strokes, tuple(said)
