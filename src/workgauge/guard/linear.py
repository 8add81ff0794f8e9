"""The linear guard: all joint speeds scaled by how near the machine is to what it approaches."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from workgauge.guard.api import GuardInput, GuardResult, Memory, full_stop, unusable
from workgauge.guard.cushion import cushioned
from workgauge.guard.joints import one_group, within_speed
from workgauge.machine.model import MachineModel
from workgauge.values.arrays import Floats, freeze
from workgauge.values.clearances import Clearances
from workgauge.values.errors import InputError
from workgauge.values.reasons import Reason, ReasonCode

#: A clearance that shrinks more slowly than this stands still: below the rounding of the rows [m/s].
RESTING_M_S = 1e-9
#: A stop distance below this counts as this, where one is weighed against another [m].
LEAST_M = 1e-3
#: At most this many reasons, the gravest first.
MAX_REASONS = 8
#: A reason's text is silent about protection levels below this [m].
WORTH_SAYING_M = 0.005


@dataclass(frozen=True, slots=True)
class LinearGuard:
    """Linear velocity scaling, Mäkinen 3.11 and 3.12, condition corrected and judged per limit.

    For each clearance, `s_i = clip((p_i - p_l) / (p_u - p_l), 0, 1)` with p_i the distance less its protection level:
    at the stop distance the machine may stand that much farther away. Reasons tell all three, distance, protection
    level and stop distance; a limit is entered (`inside_limit`) only where the distance itself is below zero.
    The smallest s_i of the clearances that the motion shrinks scales every joint speed; a motion that shrinks none of
    them is not scaled. A limit with a stop distance of its own moves p_l there, and p_u with it; a smaller one of the
    machine's own links, where the machine is small, draws p_u nearer in proportion. Beyond the equation: one tick
    never uses up more than what is left above p_l, which a coarse tick at high speed otherwise could.

    Before that, the joints' own limits: speed, exclusive groups, end cushion.

    Attributes:
        slow_distance_m: p_u, where slowing begins.
        stop_distance_m: p_l, where the approach ends.
        cushion_s: time constant of the end cushion.
    """

    slow_distance_m: float = 0.8
    stop_distance_m: float = 0.2
    cushion_s: float = 0.3

    def __post_init__(self) -> None:
        if not 0.0 <= self.stop_distance_m < self.slow_distance_m < float("inf"):
            raise InputError(
                "the guard must begin to slow before it stops",
                element="slow_distance_m",
                value=self.slow_distance_m,
                allowed=f"finite, more than stop_distance_m = {self.stop_distance_m}, itself at least 0",
            )
        if not 0.0 < self.cushion_s < float("inf"):
            raise InputError(
                "the cushion needs a width", element="cushion_s", value=self.cushion_s, allowed="above 0"
            )

    @property
    def name(self) -> str:
        """Name it is registered under."""
        return "linear"

    @property
    def steers_itself(self) -> bool:
        """It only ever holds back: automatic motion bends before limits by itself."""
        return False

    @property
    def reach_m(self) -> float:
        """Clearances up to here must be known to it [m]."""
        return self.slow_distance_m

    def start(self) -> Memory:
        """Return the memory of a guard that has done nothing yet: no exclusive group moving."""
        return {"group": -1}

    def allow(self, given: GuardInput, memory: Memory) -> tuple[GuardResult, Memory]:
        """Return the velocity that may be driven and why, and the exclusive group that moves.

        Numbers nobody can judge (NaN, infinite, wrong shapes) and clearances searched too near stop every joint.
        """
        wrong = unusable(given)
        if wrong is None and not given.clearances.searched_m >= self.reach_m:
            wrong = f"clearances are known to {given.clearances.searched_m:.2f} m, {self.reach_m:.2f} m needed"
        if wrong is not None:
            return full_stop(len(given.joint_names), wrong), self.start()
        velocity, group, reasons = self._joints(given, memory)
        qdot = np.array(velocity)
        scale = 1.0
        if len(given.clearances) and any(velocity):
            scale, near = self._scale(given.clearances, given.rows @ qdot, given.dt_s)
            if scale < 1.0:
                qdot *= scale
            reasons += near
        freeze(qdot)
        return GuardResult(qdot, tuple(reasons), scale), {"group": group}

    def idle(
        self, sent: Floats | None, machine: MachineModel, dt_s: float, elapsed_s: float, memory: Memory
    ) -> Memory:
        """Return the memory of a guard that has done nothing yet: it looks at nothing but the present."""
        return self.start()

    def _joints(self, given: GuardInput, memory: Memory) -> tuple[list[float], int, list[Reason]]:
        """Return what the joints themselves leave of the desired velocity, the moving group, and why."""
        names = given.joint_names
        positive, negative = given.speed_positive.tolist(), given.speed_negative.tolist()
        velocity, reasons = within_speed(given.desired.tolist(), positive, negative, names)
        previous = memory.get("group")
        velocity, group, held = one_group(
            velocity,
            positive,
            negative,
            given.exclusive_groups,
            names,
            previous if isinstance(previous, int) else -1,
        )
        velocity, ends = cushioned(
            velocity,
            given.q.tolist(),
            (given.q_min.tolist(), given.q_max.tolist()),
            (positive, negative),
            names,
            dt_s=given.dt_s,
            cushion_s=self.cushion_s,
            keep_direction=given.keep_direction,
        )
        return velocity, group, reasons + held + ends

    def _scale(self, clearances: Clearances, rates: Floats, dt_s: float) -> tuple[float, list[Reason]]:
        """Return the smallest scale of the approached clearances (rates (k,) [m/s]) and the reasons for it."""
        approached = (rates < -RESTING_M_S).nonzero()[0]
        if not approached.size:
            return 1.0, []
        own = clearances.stop_distances[approached]
        stops = np.where(np.isnan(own), self.stop_distance_m, own)
        safe = clearances.distances[approached] - clearances.protections[approached]
        left = safe - stops
        scales = left / self._widths(own, clearances.other_links[approached] >= 0)  # eq. 3.11
        scales = np.minimum(scales, left / (-rates[approached] * dt_s))
        scales = np.minimum(np.maximum(scales, 0.0), 1.0)
        smallest = float(np.minimum.reduce(scales))
        if smallest == 1.0:
            return 1.0, []
        return smallest, _reasons(clearances, approached, stops, scales)

    def _widths(self, own: Floats, between_links: NDArray[np.bool_]) -> Floats:
        """Return p_u - p_l (k,) for stop distances of their own (k,), NaN for none."""
        width = self.slow_distance_m - self.stop_distance_m
        smaller = between_links & (own < self.stop_distance_m)
        return np.where(smaller, width * np.maximum(own, LEAST_M) / max(self.stop_distance_m, LEAST_M), width)


def _reasons(clearances: Clearances, approached: np.ndarray, stops: Floats, scales: Floats) -> list[Reason]:
    """Return one reason per link and limit that slows the motion, the gravest first."""
    reasons: list[Reason] = []
    said = set()
    for i in np.argsort(scales, kind="stable").tolist():
        scale = float(scales[i])
        if scale == 1.0 or len(reasons) == MAX_REASONS:
            break
        k = int(approached[i])
        link = clearances.link_names[int(clearances.links[k])]
        limit = clearances.limit_ids[int(clearances.limits[k])]
        if (link, limit) in said:
            continue
        said.add((link, limit))
        distance, unsure = float(clearances.distances[k]), float(clearances.protections[k])
        stop = float(stops[i])
        doubt = f" ({unsure:.2f} m of it unsure, stops at {stop:.2f} m)" if unsure >= WORTH_SAYING_M else ""
        if distance < 0.0:
            code, text = ReasonCode.INSIDE_LIMIT, f"{-distance:.2f} m inside {limit}, only the way out is free"
        elif scale == 0.0:
            code, text = ReasonCode.LIMIT_REACHED, f"{distance:.2f} m from {limit}{doubt}, no nearer"
        else:
            code = ReasonCode.LIMIT_NEAR
            text = f"{distance:.2f} m from {limit}{doubt}, slowed to {100 * scale:.0f} %"
        reasons.append(
            Reason(
                code,
                f"{link} is {text}",
                link=link,
                limit=limit,
                clearance_m=distance,
                scale=scale,
                protection_m=unsure,
                stop_distance_m=stop,
            )
        )
    return reasons
