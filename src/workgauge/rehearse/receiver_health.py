"""Health of a log without a machine: what each receiver's own word is worth by the default thresholds."""

import math

import numpy as np

from workgauge.machine.positioning import FixSigmas, Thresholds
from workgauge.positioning.evidence import HealthMemory, HealthSeen
from workgauge.positioning.health import judge
from workgauge.rehearse.track_log import Track
from workgauge.values.navigation import FixQuality

#: Whose judgement it is, as every output states it.
WORDS = (
    "each receiver's own word by the default thresholds (quality, stated error, age of fix and correction); "
    "a machine file adds what only it knows: heading, baseline, jumps, link sensors"
)

#: Beside the log's clock, so that no time is negative [ns].
_LATER_NS = 1_000_000_000


def receiver_health(track: Track) -> list[str | None]:
    """Return a state per epoch: each source judged by itself, in order of time; None where an epoch has no time."""
    out: list[str | None] = [None] * len(track)
    known = track.t_s[np.isfinite(track.t_s)]
    if not len(known):
        return out
    zero, sigmas, thresholds = float(known.min()), FixSigmas(), Thresholds()
    with_place = track.placed
    memories: dict[str, HealthMemory] = {}
    last_fix: dict[str, tuple[int, FixQuality]] = {}
    judged: dict[str, tuple[int, str]] = {}
    for i in np.argsort(track.t_s, kind="stable"):
        source, t_s = track.sources[i], float(track.t_s[i])
        if not math.isfinite(t_s) or (track.quality[i] == -1 and not with_place[i]):
            continue
        now_ns = _LATER_NS + round((t_s - zero) * 1e9)
        if source in judged and judged[source][0] == now_ns:
            out[i] = judged[source][1]
            continue
        quality = FixQuality(max(int(track.quality[i]), 0))
        placed = bool(with_place[i]) and quality is not FixQuality.NONE
        before = last_fix.get(source)
        age = math.inf if before is None else (now_ns - before[0]) * 1e-9
        seen = HealthSeen(
            now_ns,
            fix_age_s=0.0 if placed else age,
            quality=quality if placed or before is None else before[1],
            sigma_m=_sigma(track, int(i), quality, sigmas),
            correction_age_s=float(track.correction_age_s[i]),
            innovation=0.0 if placed else math.nan,
            new_age_s=0.0 if placed else math.nan,
        )
        health, _, memories[source] = judge(seen, memories.get(source, HealthMemory()), thresholds)
        if placed:
            last_fix[source] = now_ns, quality
        judged[source] = now_ns, health.state.value
        out[i] = health.state.value
    return out


def _sigma(track: Track, i: int, quality: FixQuality, sigmas: FixSigmas) -> float:
    """Return the larger of what the receiver states and what its quality is worth, horizontally [m]."""
    known = track.sigma_m[i, :2]
    return max(sigmas.of(quality)[0], *(float(one) for one in known if math.isfinite(one)), 0.0)
