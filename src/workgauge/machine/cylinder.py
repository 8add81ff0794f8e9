"""A cylinder that turns a joint: the triangle of joint, cylinder foot and rod pin."""

import math
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Cylinder:
    """A hydraulic cylinder across a revolute joint; the joint's speed for a cylinder speed depends on its angle.

    The triangle's angle at the joint is `|offset + q|`, its opposite side the cylinder, of length
    `sqrt(a^2 + b^2 - 2 a b cos(angle))`. The joint turns fastest for a given cylinder speed at an end of its range,
    where the lever arm is shortest; the machine's full speed is meant there.

    Attributes:
        a_m, b_m: from the joint to the cylinder's foot and to its rod pin [m].
        offset_rad: the triangle's angle at joint position 0 [rad].
        q_min, q_max: the joint's range [rad], over which the triangle neither folds nor stretches out.
    """

    a_m: float
    b_m: float
    offset_rad: float
    q_min: float
    q_max: float

    @property
    def fits(self) -> bool:
        """Whether the triangle stays one over the joint's whole range."""
        low, high = self.offset_rad + self.q_min, self.offset_rad + self.q_max
        margin = math.radians(1.0)
        turned = math.floor(low / math.pi) * math.pi
        return low - turned > margin and turned + math.pi - high > margin

    def length_m(self, q: float) -> float:
        """Return the cylinder's length at joint position q [rad]."""
        a, b = self.a_m, self.b_m
        return math.sqrt(a * a + b * b - 2.0 * a * b * math.cos(self.offset_rad + q))

    def _per_metre(self, q: float) -> float:
        """Return by how much the joint turns per metre of cylinder, signed [rad/m]."""
        return self.length_m(q) / (self.a_m * self.b_m * math.sin(self.offset_rad + q))

    @property
    def fastest(self) -> float:
        """The most the joint turns per metre of cylinder within its range, signed as extension turns it [rad/m]."""
        return max(self._per_metre(self.q_min), self._per_metre(self.q_max), key=abs)

    def gain(self, q: float) -> float:
        """Return the joint's speed at q over its speed where the cylinder turns it fastest, above 0, at most 1."""
        inside = min(max(q, self.q_min), self.q_max)
        return min(self._per_metre(inside) / self.fastest, 1.0)

    def moved(self, q: float, way: float) -> float:
        """Return where the joint is after the cylinder made a way, exactly; it ends where the joint does.

        Args:
            q: from there [rad]. way: what the joint would have turned where the cylinder turns it fastest [rad].
        """
        if way == 0.0:
            return q
        ends = sorted((self.length_m(self.q_min), self.length_m(self.q_max)))
        length = self.length_m(q) + way / self.fastest
        if not ends[0] < length < ends[1]:
            return self.q_max if way > 0.0 else self.q_min
        a, b = self.a_m, self.b_m
        angle = math.acos(min(max((a * a + b * b - length * length) / (2.0 * a * b), -1.0), 1.0))
        turns, sign = math.floor((self.offset_rad + q) / math.pi), 1.0
        if turns % 2:
            turns, sign = turns + 1, -1.0
        return turns * math.pi + sign * angle - self.offset_rad
