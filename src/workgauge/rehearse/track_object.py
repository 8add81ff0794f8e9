"""The documented object of `workgauge pose --json`."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from workgauge.rehearse.track_log import Track

QUALITY_WORDS = {
    -1: "quality unknown",
    0: "no fix",
    1: "single",
    2: "differential",
    3: "PPS",
    4: "RTK fixed",
    5: "RTK float",
    6: "dead reckoning",
    7: "manual",
    8: "simulated",
    9: "another quality",
}


def number(value: float, decimals: int) -> float | None:
    """Return a number rounded, None for what is not finite."""
    return round(float(value), decimals) if math.isfinite(value) else None


def epochs_object(
    track: Track,
    health: Sequence[str | None],
    health_words: str,
    machine: Sequence[dict[str, Any] | None] | None = None,
) -> dict[str, Any]:
    """Return `{"epochs": [...], "sentences": {...}, ...}`; what is unknown is None.

    Args:
        track: n epochs. health: a state per epoch. health_words: whose judgement that is.
        machine: what the machine's own positioning makes of each.
    """
    lat, lon = np.degrees(track.latitude), np.degrees(track.longitude)
    heading, true_heading = np.degrees(track.heading), np.degrees(track.true_heading)
    epochs = []
    for i in range(len(track)):
        sigma = track.sigma_m[i]
        epoch: dict[str, Any] = {
            "t": number(track.t_s[i], 6),
            "lat_deg": number(lat[i], 11),
            "lon_deg": number(lon[i], 11),
            "h_m": number(track.height_ellipsoid_m[i], 5),
            "e": number(track.e[i], 5),
            "n": number(track.n[i], 5),
            "z": number(track.z[i], 5),
            "quality": None if track.quality[i] < 0 else int(track.quality[i]),
            "sigma_m": [number(one, 5) for one in sigma] if np.isfinite(sigma).any() else None,
            "heading_deg": number(heading[i], 6),
            "health": health[i],
            "heading_true_deg": number(true_heading[i], 6),
            "source": track.sources[i] or None,
            "sigma_stated": bool(track.sigma_stated[i]),
        }
        if machine is not None:
            epoch["machine"] = machine[i]
        epochs.append(epoch)
    return {
        "epochs": epochs,
        "sentences": {key: int(track.tally[key]) for key in ("good", "bad", "unknown")},
        "rejected": {str(reason): int(many) for reason, many in sorted(track.tally["reasons"].items())},
        "time": "utc" if track.utc else "day",
        "crs": {"epsg": track.crs.epsg, "name": track.crs.name},
        "height": track.height_words,
        "health": health_words,
        "files": list(track.files),
        "warnings": list(track.warnings),
    }
