"""The drive for hydraulic joints: over the dead band, by direction, posture and the pump's flow."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

from workgauge.machine.cylinder import Cylinder
from workgauge.machine.model import MachineModel
from workgauge.values.commands import VALVE_FULL

_Pair = tuple[float, float]


@dataclass(frozen=True, slots=True)
class HydraulicDrive:
    """Joint velocities to valves and back where valves have dead bands and joints share a pump.

    A valve is either closed or beyond its dead band. Every valve is rounded towards zero in speed, and the pump's
    flow scales all speeds alike, so a command is never faster than asked and never asks for more than the pump gives.

    Attributes:
        full_speed: (n) joint speed at the full valve, (positive, negative) direction [rad/s, m/s]; with a cylinder,
            where that turns the joint fastest.
        dead_band: (n) share of the valve's travel that does nothing, (positive, negative), 0 to below 1.
        flow: (n) flow at full speed, (positive, negative); empty if there is enough.
        pump: flow the pump gives, in the same unit.
        cylinders: (n) or empty.
        rest: share of full speed below which a joint at rest is not set in motion: noise about zero would otherwise
            jump over the dead band to and fro.
        keep: share of full speed below which one that moves is stopped, at most `rest`.
    """

    full_speed: tuple[_Pair, ...]
    dead_band: tuple[_Pair, ...]
    flow: tuple[_Pair, ...] = ()
    pump: float = math.inf
    cylinders: tuple[Cylinder | None, ...] = ()
    rest: float = 0.005
    keep: float = 0.002

    @classmethod
    def of(cls, machine: MachineModel, dead_band: Sequence[_Pair] | float = 0.0) -> "HydraulicDrive":
        """Return the drive of a machine.

        Args:
            machine: its speeds, pump and cylinders. dead_band: (n) pairs, or one for all.
        """
        speeds = tuple(zip(machine.speed_positive.tolist(), machine.speed_negative.tolist(), strict=True))
        bands = ((dead_band, dead_band),) * machine.n if isinstance(dead_band, float | int) else tuple(dead_band)
        if machine.pump is None:
            return cls(speeds, bands, cylinders=machine.cylinders)
        pump = machine.pump
        flows = tuple(zip(pump.flow_positive.tolist(), pump.flow_negative.tolist(), strict=True))
        return cls(speeds, bands, flows, pump.flow, machine.cylinders)

    @property
    def jump(self) -> tuple[tuple[int, int], ...]:
        """Return the dead bands (n) as openings, positive and negative side."""
        return tuple((_closed(up), _closed(down)) for up, down in self.dead_band)

    def valves(
        self,
        velocity: Sequence[float],
        q: Sequence[float] | None = None,
        previous: Sequence[int] | None = None,
    ) -> tuple[int, ...]:
        """Return the valve openings (n) nearest to and no faster than `velocity` (n) [rad/s, m/s].

        If any speed is not a number, all are neutral.

        Args:
            velocity: wanted.
            q: (n) joint positions; without, every cylinder is taken to turn its joint as fast as anywhere.
            previous: (n) the valves sent last; joints they move go on down to `keep`, without them every joint is
                taken to be at rest.
        """
        n = len(self.full_speed)
        if not all(map(math.isfinite, velocity)) or (q is not None and not all(map(math.isfinite, q))):
            return (0,) * n
        full = self._full(velocity, q)
        shares = [min(abs(v) / top, 1.0) for v, top in zip(velocity, full, strict=True)]
        scale = self._pump_share(velocity, shares)
        before = previous or (0,) * n
        out = []
        for j, v in enumerate(velocity):
            least = self.keep if before[j] * v > 0.0 else self.rest
            resting = scale * shares[j] < least
            size = 0 if resting else _opening(scale * min(abs(v), full[j]), full[j], self.dead_band[j][v < 0.0])
            out.append(size if v > 0.0 else -size)
        return tuple(out)

    def velocity(self, valves: Sequence[int], q: Sequence[float] | None = None) -> tuple[float, ...]:
        """Return the joint velocities (n) [rad/s, m/s] that valve openings (n) come to, once nothing changes."""
        full = self._full(valves, q)
        shares = [_share(abs(valve), self.dead_band[j][valve < 0]) for j, valve in enumerate(valves)]
        scale = self._pump_share(valves, shares)
        return tuple(
            math.copysign(scale * share * top, valve) if share else 0.0
            for valve, share, top in zip(valves, shares, full, strict=True)
        )

    def _full(self, signs: Sequence[float], q: Sequence[float] | None) -> list[float]:
        """Return the full speed of each joint in the direction of `signs`, in the posture q."""
        full = [pair[sign < 0] for pair, sign in zip(self.full_speed, signs, strict=True)]
        if q is not None:
            for j, cylinder in enumerate(self.cylinders):
                if cylinder is not None:
                    full[j] *= cylinder.gain(q[j])
        return full

    def _pump_share(self, signs: Sequence[float], shares: Sequence[float]) -> float:
        """Return what the pump leaves of all speeds together, 0 to 1."""
        if not self.flow:
            return 1.0
        asked = sum(share * pair[sign < 0] for share, pair, sign in zip(shares, self.flow, signs, strict=True))
        return self.pump / asked if asked > self.pump else 1.0


def led(
    velocity: Sequence[float], before: Sequence[float], lead_s: Sequence[float], dt_s: float
) -> tuple[float, ...]:
    """Return velocities (n) that make up for joints' lags where they slow down: `v + lead dv/dt`.

    Bounded: never beyond zero, and never faster than `velocity`. A joint that speeds up is left as it is; to hurry it
    would mean to ask for more than the guard allowed.

    Args:
        velocity: (n) wanted now. before: (n) wanted one tick ago. lead_s: (n) 0 for none, at most the lag [s].
        dt_s: the tick's period [s].
    """
    out = []
    for v, was, lead in zip(velocity, before, lead_s, strict=True):
        wanted = v + lead * (v - was) / dt_s
        slowing = v * was > 0.0 and abs(v) < abs(was)
        out.append((max(wanted, 0.0) if v > 0.0 else min(wanted, 0.0)) if slowing else v)
    return tuple(out)


def _share(opening: int, band: float) -> float:
    """Return the share of full speed at an opening, 0 to VALVE_FULL."""
    return max(opening / VALVE_FULL - band, 0.0) / (1.0 - band)


@lru_cache(maxsize=256)
def _closed(band: float) -> int:
    """Return the largest opening that has no share of full speed."""
    opening = math.floor(band * VALVE_FULL) + 1
    while _share(opening, band) > 0.0:
        opening -= 1
    return opening


def _opening(speed: float, full: float, band: float) -> int:
    """Return the largest opening whose speed, as `_share` gives it, does not exceed `speed`; 0 for no speed."""
    if speed >= full:
        return VALVE_FULL
    opening = min(int((band + speed / full * (1.0 - band)) * VALVE_FULL) + 1, VALVE_FULL)
    while opening > 0 and _share(opening, band) * full > speed:
        opening -= 1
    return opening if _share(opening, band) > 0.0 else 0
