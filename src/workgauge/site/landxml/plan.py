"""From stated elements to a plan: small misclosures, gaps and kinks are spread or noted, large ones refused."""

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from workgauge.site.landxml.document import Document
from workgauge.site.landxml.elements import SMALLEST_RADIUS_M, StatedElement
from workgauge.site.plan import PlanElement, PlanGeometry
from workgauge.site.transitions import Law
from workgauge.values.arrays import Floats
from workgauge.values.errors import SiteError

#: An element may miss its stated end by this much; the miss is spread over its length [m].
MISCLOSURE_LIMIT_M = 0.020
MISCLOSURE_WARN_M = 0.001
#: The next element may start this far from the end; the gap is spread as well [m].
GAP_LIMIT_M = 0.010
GAP_WARN_M = 0.0005
#: The heading may jump by this much from element to element [rad]: 0.57 and 0.06 degrees.
KINK_LIMIT_RAD = 0.010
KINK_WARN_RAD = 0.001
#: Stated lengths and radii may differ by this much from the coordinates without a warning [m].
LENGTH_WARN_M = 0.005
#: Elements shorter than this are left out [m].
SHORTEST_M = 1e-6
#: A tangent point nearer to the start than this gives no direction [m].
SHORTEST_TANGENT_M = 0.1
#: Origins are whole multiples of this [m].
_ORIGIN_STEP_M = 100.0


def wrapped(angle: float) -> float:
    """Return an angle in (-pi, pi] [rad]."""
    return math.pi - (math.pi - angle) % (2 * math.pi)


@dataclass
class PlanBuilder:
    """Builds the plan of one owner (`Alignment 'x'`), noting every correction in the document."""

    document: Document
    owner: str

    def build(self, stated: Sequence[StatedElement]) -> PlanGeometry:
        """Return the plan.

        Raises:
            SiteError: no element with a length, misclosures above 20 mm, gaps above 10 mm, kinks above 0.01 rad.
        """
        stated = self._with_length(stated)
        for before, after in itertools.pairwise(stated):
            self._check_gap(before, after)
        origin = np.round(stated[0].start[:2] / _ORIGIN_STEP_M) * _ORIGIN_STEP_M
        elements: list[PlanElement | None] = [self._own(item, origin) for item in stated]
        for i, item in enumerate(stated):
            if elements[i] is None:
                elements[i] = self._spiral(item, origin, elements[i - 1] if i else None, elements[i + 1 : i + 2])
        done = [e for e in elements if e is not None]
        for i in range(1, len(done)):
            self._check_kink(stated[i], done[i - 1], done[i])
        closed = [self._close(stated, done, origin, i) for i in range(len(done))]
        return PlanGeometry((float(origin[0]), float(origin[1])), closed)

    def _with_length(self, stated: Sequence[StatedElement]) -> list[StatedElement]:
        kept = []
        for item in stated:
            apart = float(np.hypot(*(item.end - item.start)[:2]))
            if apart < SHORTEST_M and (item.kind == "line" or (item.length or 0.0) < SHORTEST_M):
                self._warn(item, "has no length and is left out")
            else:
                kept.append(item)
        if not kept:
            raise self.document.error("has no element with a length", self.owner)
        return kept

    def _warn(self, item: StatedElement, text: str) -> None:
        self.document.warn(text, f"{self.owner}: {item.name}", item.line)

    def _error(self, item: StatedElement, text: str, value: object, allowed: str) -> SiteError:
        return SiteError(
            text,
            file=self.document.path,
            line=item.line,
            element=f"{self.owner}: {item.name}",
            value=value,
            allowed=allowed,
        )

    def _own(self, item: StatedElement, origin: Floats) -> PlanElement | None:
        """Return the element where its own statement fixes its heading, None for a spiral without a tangent point."""
        start = item.start[:2] - origin
        to_end = item.end[:2] - item.start[:2]
        place = (float(start[0]), float(start[1]))
        if item.kind == "line":
            length = math.hypot(*to_end)
            self._compare(item, "length", item.length, length)
            return PlanElement("line", Law.CONSTANT, place, math.atan2(to_end[1], to_end[0]), length, 0.0, 0.0)
        if item.kind == "curve":
            return self._arc(item, place)
        assert item.length is not None
        if item.pi is None:
            return None
        flat = PlanElement("spiral", item.law, place, 0.0, item.length, item.k0, item.k1)
        first, last = item.pi[:2] - item.start[:2], item.end[:2] - item.pi[:2]
        yaws = [
            math.atan2(tangent[1], tangent[0]) - turn
            for tangent, turn in ((first, 0.0), (last, flat.end_yaw()))
            if math.hypot(*tangent) > SHORTEST_TANGENT_M
        ]
        # A spiral that turns by more than half a circle has its tangents meet behind it.
        chord = self._chord_yaw(item, flat)
        yaws = [yaw + (math.pi if abs(wrapped(yaw - chord)) > math.pi / 2 else 0.0) for yaw in yaws]
        return self._best(item, flat, yaws, origin) if yaws else None

    @staticmethod
    def _best(item: StatedElement, flat: PlanElement, yaws: Sequence[float], origin: Floats) -> PlanElement:
        """Return the spiral with that one of several first tangents with which it ends nearest to its stated end.

        Transitions other than clothoids are often computed by series from their straight end; held by the tangent
        there they close within millimetres, held by the other one they may miss by decimetres.
        """
        held = [replace(flat, yaw=yaw) for yaw in yaws]
        return min(held, key=lambda e: math.hypot(*(np.array(e.end()) - (item.end[:2] - origin))))

    @staticmethod
    def _chord_yaw(item: StatedElement, flat: PlanElement) -> float:
        """Return the heading that points the spiral's own chord at its stated end."""
        x, y = (a - b for a, b in zip(flat.end(), flat.start, strict=True))
        to_end = item.end[:2] - item.start[:2]
        return math.atan2(to_end[1], to_end[0]) - math.atan2(y, x)

    def _spiral(
        self,
        item: StatedElement,
        origin: Floats,
        before: PlanElement | None,
        after: Sequence[PlanElement | None],
    ) -> PlanElement:
        """Return a spiral without a tangent point, its heading from its neighbours or else from its own chord."""
        assert item.length is not None
        start = item.start[:2] - origin
        flat = PlanElement("spiral", item.law, (float(start[0]), float(start[1])), 0.0, item.length, item.k0, item.k1)
        yaws = [] if before is None else [before.end_yaw()]
        if after and after[0] is not None:
            yaws.append(after[0].yaw - flat.end_yaw())
        if yaws:
            return self._best(item, flat, yaws, origin)
        self._warn(item, "has neither a PI nor a neighbour; its heading is taken from its chord")
        return replace(flat, yaw=self._chord_yaw(item, flat))

    def _arc(self, item: StatedElement, place: tuple[float, float]) -> PlanElement:
        centre = self._centre(item) if item.centre is None else item.centre[:2]
        spoke0, spoke1 = item.start[:2] - centre, item.end[:2] - centre
        r0, r1 = math.hypot(*spoke0), math.hypot(*spoke1)
        if not abs(r0 - r1) <= MISCLOSURE_LIMIT_M or min(r0, r1) < SMALLEST_RADIUS_M:
            raise self._error(
                item,
                "start and end are not equally far from the centre",
                f"{r0:.4f} and {r1:.4f} m",
                f"a difference of {1000 * MISCLOSURE_LIMIT_M:.0f} mm",
            )
        radius = (r0 + r1) / 2
        a0, a1 = math.atan2(spoke0[1], spoke0[0]), math.atan2(spoke1[1], spoke1[0])
        sweep = (item.turn * (a1 - a0)) % (2 * math.pi)
        if sweep * radius < SHORTEST_M and (item.length or 0.0) > math.pi * radius:
            sweep += 2 * math.pi
        length = radius * sweep
        if length < SHORTEST_M:
            raise self._error(item, "a curve whose ends coincide", f"length {item.length}", "two different ends")
        self._compare(item, "length", item.length, length)
        self._compare(item, "radius", item.radius, radius)
        curvature = item.turn / radius
        return PlanElement("curve", Law.CONSTANT, place, a0 + item.turn * math.pi / 2, length, curvature, curvature)

    def _centre(self, item: StatedElement) -> Floats:
        """Return the centre of an arc stated by its ends, rotation and radius, or else its tangent point."""
        if not item.radius and item.pi is not None:
            return self._centre_by_tangents(item, item.pi)
        if not item.radius:
            raise self._error(item, "needs a Center, a radius or a PI", item.radius, "one of the three")
        chord = (item.end - item.start)[:2]
        half = math.hypot(*chord) / 2
        if half - item.radius > MISCLOSURE_LIMIT_M / 2:
            raise self._error(item, "radius too small for its ends", item.radius, f"at least {half:.3f} m")
        if half < SHORTEST_M:
            raise self._error(item, "a closed curve needs a Center", "none", "a Center")
        height = math.sqrt(max(item.radius**2 - half**2, 0.0))
        left = np.array([-chord[1], chord[0]]) / (2 * half)
        side = item.turn if (item.length or 0.0) <= math.pi * item.radius else -item.turn
        centre: Floats = item.start[:2] + chord / 2 + side * height * left
        return centre

    def _centre_by_tangents(self, item: StatedElement, pi: Floats) -> Floats:
        """Return the centre square to the first tangent, at start, and as far from the end."""
        first, last, chord = (pi - item.start)[:2], (item.end - pi)[:2], (item.end - item.start)[:2]
        apart = math.hypot(*first) - math.hypot(*last)
        if not abs(apart) <= MISCLOSURE_LIMIT_M:
            raise self._error(
                item,
                "start and end are not equally far from the PI",
                f"{math.hypot(*first):.4f} and {math.hypot(*last):.4f} m",
                f"a difference of {1000 * MISCLOSURE_LIMIT_M:.0f} mm",
            )
        left = np.array([-first[1], first[0]]) / max(math.hypot(*first), SHORTEST_M)
        aside = float(chord @ left)
        if abs(aside) < SHORTEST_M:
            raise self._error(item, "its PI lies on its chord", "no curve", "a Center or a radius")
        reach = float(chord @ chord) / (2 * aside)
        if item.turn * reach < 0 and not (item.length or 0.0) > math.pi * abs(reach):
            raise self._error(item, "rot contradicts the PI", "cw" if item.turn < 0 else "ccw", "the other way")
        centre: Floats = item.start[:2] + reach * left
        return centre

    def _compare(self, item: StatedElement, what: str, stated: float | None, measured: float) -> None:
        if stated is not None and abs(stated - measured) > max(LENGTH_WARN_M, 1e-5 * measured):
            self._warn(item, f"{what} {stated:.4f} m stated, {measured:.4f} m by its coordinates, which count")

    def _check_gap(self, before: StatedElement, after: StatedElement) -> None:
        gap = float(np.hypot(*(after.start - before.end)[:2]))
        if not gap <= GAP_LIMIT_M:
            raise self._error(
                after,
                "the alignment has a gap before this element",
                f"{1000 * gap:.1f} mm",
                f"{1000 * GAP_LIMIT_M:.0f} mm",
            )
        if gap > GAP_WARN_M:
            self._warn(after, f"begins {1000 * gap:.1f} mm from the end before it; spread")

    def _check_kink(self, item: StatedElement, before: PlanElement, after: PlanElement) -> None:
        kink = wrapped(after.yaw - before.end_yaw())
        if not abs(kink) <= KINK_LIMIT_RAD:
            raise self._error(
                item,
                "the alignment has a kink where this element begins",
                f"{math.degrees(kink):.3f} degrees",
                f"{math.degrees(KINK_LIMIT_RAD):.2f} degrees",
            )
        if abs(kink) > KINK_WARN_RAD:
            self._warn(item, f"begins with a kink of {math.degrees(kink):.4f} degrees")

    def _close(
        self,
        stated: Sequence[StatedElement],
        done: Sequence[PlanElement],
        origin: Floats,
        i: int,
    ) -> PlanElement:
        """Return element i made to end where the next begins."""
        item, element = stated[i], done[i]
        end = np.array(element.end())
        stated_end = item.end[:2] - origin
        miss = float(np.hypot(*(stated_end - end)))
        if not miss <= MISCLOSURE_LIMIT_M:
            raise self._error(
                item,
                "does not end where it says",
                f"{1000 * miss:.1f} mm off",
                f"{1000 * MISCLOSURE_LIMIT_M:.0f} mm",
            )
        if miss > MISCLOSURE_WARN_M:
            self._warn(item, f"misses its stated end by {1000 * miss:.1f} mm; spread over its length")
        target = stated_end
        if i + 1 < len(done):
            target = np.array(done[i + 1].start)
        correction = target - end
        return replace(element, correction=(float(correction[0]), float(correction[1])))
