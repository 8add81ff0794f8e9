"""How long a receiver has said the very same: only what it says counts, not its silence about a place."""

import math

from workgauge.positioning.timing import Heard
from workgauge.values.measurements import Stamp
from workgauge.values.navigation import FixQuality, GnssFix

MS = 1_000_000


def told(heard: Heard, k: int, latitude: float, quality: FixQuality = FixQuality.FIXED) -> Heard:
    stamp = Stamp("m", k * 50 * MS, "gnss/GN", k * 50 * MS)
    fix = GnssFix(stamp, "GGA", latitude, latitude, time_of_day_s=k * 0.05, height_msl_m=latitude, quality=quality)
    return heard.hear(fix, 20 * MS, 500 * MS)


def test_repeated_coordinates_are_counted_from_their_first() -> None:
    heard = Heard()
    for k in range(41):
        heard = told(heard, k, 1.0)
    assert math.isclose(heard.same_for_s, 2.0, abs_tol=0.02)
    assert told(heard, 41, 1.0 + 1e-12).same_for_s == 0.0


def test_a_receiver_without_a_fix_does_not_hang() -> None:
    heard = told(Heard(), 0, 1.0)
    for k in range(1, 100):
        heard = told(heard, k, math.nan, FixQuality.NONE)
        assert heard.same_for_s == 0.0
    assert told(heard, 100, 1.0).same_for_s <= 0.051
