"""Guards to compare with, as they are made elsewhere: one scale for all, fixed speed bands, the nearest pair alone.

They get what every guard gets (clearances of the present posture, their protection levels, the joints' own limits)
and keep the same stop distance. None knows how the joints stop.
"""

import math
from dataclasses import dataclass

import daqp
import numpy as np

from workgauge.guard.api import GuardInput, GuardResult, Memory, full_stop, unusable
from workgauge.guard.cushion import cushioned
from workgauge.guard.joints import one_group, within_speed
from workgauge.machine.model import MachineModel
from workgauge.values.arrays import Floats, frozen
from workgauge.values.clearances import Clearances
from workgauge.values.reasons import Reason, ReasonCode

#: A clearance that shrinks slower than this rests [m/s].
RESTING_M_S = 1e-9
CUSHION_S = 0.3


@dataclass(frozen=True, slots=True)
class _Baseline:
    """What the baselines share.

    Attributes:
        stop_distance_m: smallest clearance, where a limit has none of its own.
    """

    stop_distance_m: float = 0.2

    @property
    def name(self) -> str:
        """Name in the tables."""
        return "baseline"

    @property
    def steers_itself(self) -> bool:
        """They only ever hold back."""
        return False

    @property
    def reach_m(self) -> float:
        """Clearances up to here must be known to it [m]."""
        return self.stop_distance_m

    def start(self) -> Memory:
        """Return the memory of a guard that has done nothing yet."""
        return {"group": -1}

    def idle(
        self, sent: Floats | None, machine: MachineModel, dt_s: float, elapsed_s: float, memory: Memory
    ) -> Memory:
        """Return the memory after a tick in which nobody asked: none of them remembers what flies."""
        return self.start()

    def allow(self, given: GuardInput, memory: Memory) -> tuple[GuardResult, Memory]:
        """Return the velocity that may be driven: what `_left` leaves of what the joints can do."""
        wrong = unusable(given)
        if wrong is not None:
            return full_stop(len(given.joint_names), wrong), self.start()
        names = given.joint_names
        positive, negative = given.speed_positive.tolist(), given.speed_negative.tolist()
        velocity, reasons = within_speed(given.desired.tolist(), positive, negative, names)
        previous = memory.get("group")
        group = previous if isinstance(previous, int) else -1
        velocity, group, held = one_group(velocity, positive, negative, given.exclusive_groups, names, group)
        wanted = np.array(velocity)
        left = self._left(given, wanted, _slack(given.clearances, self.stop_distance_m))
        if (left != wanted).any():
            reasons += _nearest(given.clearances)
        velocity, ends = cushioned(
            left.tolist(),
            given.q.tolist(),
            (given.q_min.tolist(), given.q_max.tolist()),
            (positive, negative),
            names,
            dt_s=given.dt_s,
            cushion_s=CUSHION_S,
            keep_direction=given.keep_direction,
        )
        size = float(np.linalg.norm(wanted))
        scale = min(float(np.linalg.norm(left)) / size, 1.0) if size else 1.0
        return GuardResult(frozen(velocity), (*reasons, *held, *ends), scale), {"group": group}

    def _left(self, given: GuardInput, wanted: Floats, slack: Floats) -> Floats:
        """Return what the clearances leave of the wanted velocity (n,); slack (k,): beyond the stop [m]."""
        raise NotImplementedError


@dataclass(frozen=True, slots=True)
class ExponentialScale(_Baseline):
    """One scale for all joints and directions by the nearest distance, as MoveIt Servo's collision monitor has it.

    `scale = exp(k (d - threshold))` below the threshold, `k = -ln(0.001) / threshold`, so a thousandth at zero, and
    zero in collision. Servo's own thresholds are 0.01 m and 0.02 m from contact, for small quick arms; here distance
    counts from the stop distance, and the threshold is where linear scaling begins.

    Attributes:
        threshold_m: where slowing begins, beyond the stop distance.
    """

    threshold_m: float = 0.6

    @property
    def name(self) -> str:
        """Name in the tables."""
        return "one-scale"

    @property
    def reach_m(self) -> float:
        """Clearances up to here must be known to it [m]."""
        return self.stop_distance_m + self.threshold_m

    def _left(self, given: GuardInput, wanted: Floats, slack: Floats) -> Floats:
        nearest = float(slack.min(initial=math.inf))
        if nearest >= self.threshold_m:
            return wanted
        if nearest <= 0.0:
            return np.zeros_like(wanted)
        return wanted * math.exp(-math.log(0.001) / self.threshold_m * (nearest - self.threshold_m))


@dataclass(frozen=True, slots=True)
class SpeedBands(_Baseline):
    """Fixed bands, as in limiters for road-rail machines: full speed, creep speed, stop, joint by joint.

    A joint whose motion alone shrinks a clearance creeps within the outer band and stops within the inner one; one
    that backs away is free.

    Attributes:
        outer_m, inner_m: the bands' edges, beyond the stop distance. creep: share of full speed in the outer one.
    """

    outer_m: float = 1.0
    inner_m: float = 0.1
    creep: float = 0.25

    @property
    def name(self) -> str:
        """Name in the tables."""
        return "bands"

    @property
    def reach_m(self) -> float:
        """Clearances up to here must be known to it [m]."""
        return self.stop_distance_m + self.outer_m

    def _left(self, given: GuardInput, wanted: Floats, slack: Floats) -> Floats:
        closing = given.rows * wanted < -RESTING_M_S
        outer = (closing & (slack < self.outer_m)[:, None]).any(axis=0)
        inner = (closing & (slack < self.inner_m)[:, None]).any(axis=0)
        most = self.creep * np.where(wanted > 0.0, given.speed_positive, given.speed_negative)
        crept = np.sign(wanted) * np.minimum(np.abs(wanted), most)
        return np.where(inner, 0.0, np.where(outer, crept, wanted))


@dataclass(frozen=True, slots=True)
class NearestPairBarrier(_Baseline):
    """The barrier with one closest pair and no prediction: the nearest admissible velocity to the wanted one.

    `min |v - wanted|^2` subject to `row v >= -slack / time_s` for the one clearance with the least slack at the
    present posture, and joint speeds.

    Attributes:
        time_s: the approach may use up the slack in this time. sight_m: how far it looks.
    """

    time_s: float = 0.6
    sight_m: float = 6.0

    @property
    def name(self) -> str:
        """Name in the tables."""
        return "nearest-pair"

    @property
    def reach_m(self) -> float:
        """Clearances up to here must be known to it [m]."""
        return self.sight_m

    def _left(self, given: GuardInput, wanted: Floats, slack: Floats) -> Floats:
        if not len(slack):
            return wanted
        i = int(np.argmin(slack))
        least = -max(float(slack[i]), 0.0) / self.time_s
        if float(given.rows[i] @ wanted) >= least:
            return wanted
        lower, upper = np.append(-given.speed_negative, least), np.append(given.speed_positive, 1e30)
        row = np.array(given.rows[i : i + 1])
        solution, _, flag, _ = daqp.solve(np.eye(len(wanted)), -wanted, row, upper, lower)
        return np.asarray(solution) if flag == 1 else np.zeros_like(wanted)


def _slack(clearances: Clearances, stop_distance_m: float) -> Floats:
    """Return what is sure of every clearance beyond its stop distance (k,) [m]."""
    own = clearances.stop_distances
    return clearances.distances - clearances.protections - np.where(np.isnan(own), stop_distance_m, own)


def _nearest(clearances: Clearances) -> list[Reason]:
    near = clearances.nearest()
    if near is None:
        return []
    text = f"{near.link} is {near.distance_m:.2f} m from {near.limit}"
    return [Reason(ReasonCode.LIMIT_NEAR, text, link=near.link, limit=near.limit, clearance_m=near.distance_m)]


#: Name to baseline.
BASELINES = {made().name: made for made in (ExponentialScale, SpeedBands, NearestPairBarrier)}
