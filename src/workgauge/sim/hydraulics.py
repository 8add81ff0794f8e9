"""Hydraulic joints: dead band, dead time, lag, limited acceleration, one pump for all."""

import math
from collections import deque
from dataclasses import dataclass

import numpy as np

from workgauge.machine.parts import Pump
from workgauge.machine.stopping import StoppingModel
from workgauge.values.arrays import Floats


@dataclass(frozen=True, slots=True, eq=False)
class HydraulicSpec:
    """How the joints of a simulated machine follow their valves; all arrays (2, n), positive direction first.

    Attributes:
        dead_time_s, lag_s, deceleration: as in `StoppingModel`; deceleration limits every change of speed.
        dead_band: share of the valve's travel that does nothing, 0 to below 1.
        full_speed: joint speed at the full valve [rad/s, m/s].
        valve_rate: share of the valve's travel per second at most, inf for none.
        pump: shared flow, or None for enough.
    """

    dead_time_s: Floats
    lag_s: Floats
    deceleration: Floats
    dead_band: Floats
    full_speed: Floats
    valve_rate: float = math.inf
    pump: Pump | None = None

    @classmethod
    def of(cls, model: StoppingModel, full_speed: Floats, pump: Pump | None = None) -> "HydraulicSpec":
        """Return joints that stop exactly as the model says, without a dead band."""
        return cls(
            model.dead_time_s, model.lag_s, model.deceleration, np.zeros_like(full_speed), full_speed, math.inf, pump
        )


class Hydraulics:
    """The joints' state; `advance` moves it on.

    Args:
        spec: how they follow. substep_s: integration step; dead times are kept to a fraction of it.
    """

    def __init__(self, spec: HydraulicSpec, substep_s: float = 0.0025) -> None:
        self.spec = spec
        self._h = substep_s
        self._n = spec.full_speed.shape[1]
        self.velocity = np.zeros(self._n)
        self._valve = np.zeros(self._n)
        length = math.ceil(float(spec.dead_time_s.max(initial=0.0)) / substep_s) + 2
        self._past = deque([np.zeros((2, self._n)) for _ in range(length)], maxlen=length)

    def advance(self, valve: Floats) -> Floats:
        """Return the displacement (n,) over one substep with the valves asked for at `valve` (n,), -1 to 1."""
        spec, h = self.spec, self._h
        change = np.clip(valve - self._valve, -spec.valve_rate * h, spec.valve_rate * h)
        self._valve = self._valve + change
        sides = np.stack([np.maximum(self._valve, 0.0), np.maximum(-self._valve, 0.0)])
        opened = np.maximum(sides - spec.dead_band, 0.0) / (1.0 - spec.dead_band)
        self._past.append(opened)
        behind = spec.dead_time_s / h
        whole = np.floor(behind).astype(np.intp)
        share = behind - whole
        past = np.array(self._past)
        last = len(past) - 1
        side, joint = np.indices((2, self._n))
        acting = (1.0 - share) * past[last - whole, side, joint] + share * past[
            np.maximum(last - whole - 1, 0), side, joint
        ]
        if spec.pump is not None:
            asked = float(acting[0] @ spec.pump.flow_positive + acting[1] @ spec.pump.flow_negative)
            if asked > spec.pump.flow:
                acting = acting * (spec.pump.flow / asked)
        wanted = acting[0] * spec.full_speed[0] - acting[1] * spec.full_speed[1]
        v = self.velocity
        which = np.where((v > 0.0) | ((v == 0.0) & (wanted > 0.0)), 0, 1)
        j = np.arange(self._n)
        lag, a = spec.lag_s[which, j], np.minimum(spec.deceleration[which, j], 1e9)
        gap = wanted - v
        braking = np.minimum(np.maximum(np.abs(gap) - a * lag, 0.0) / a, h)
        dv = np.copysign(a * braking, gap)
        way = (v + 0.5 * dv) * braking
        v, rest = v + dv, h - braking
        gap = wanted - v
        with np.errstate(divide="ignore", invalid="ignore"):
            settled = np.where(lag > 0.0, -np.expm1(-rest / lag), np.where(rest > 0.0, 1.0, 0.0))
        self.velocity = v + gap * settled
        return np.asarray(way + wanted * rest - gap * lag * settled)
