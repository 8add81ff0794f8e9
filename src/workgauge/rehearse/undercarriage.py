"""What a session's driver asks of the undercarriage, and what is left of it."""

import math

from workgauge.gauge.following import OnTracks
from workgauge.loop.tick import Trace
from workgauge.rehearse.navigation import Known
from workgauge.rehearse.setting import Setting
from workgauge.rehearse.travelling import Travel, TravelGround, allowed_travel, believed_place
from workgauge.rehearse.ways import RailPlace


class Undercarriage:
    """Remembers how fast the undercarriage is to travel, and says how fast it may.

    Args:
        setting: what the session is about.
    """

    def __init__(self, setting: Setting) -> None:
        self._setting = setting
        self._ground = TravelGround(
            *(setting.machine, setting.limit_set.limits, setting.follower.tracks, setting.brakes, setting.guard)
        )
        self._wanted = 0.0, 0.0

    @property
    def start_along_m(self) -> tuple[float, float] | None:
        """Where on its alignment the machine started [m], and +1 or -1 for facing along or against it, or None."""
        place = self._setting.place
        return (place.distance_m, 1.0 if place.forward else -1.0) if isinstance(place, RailPlace) else None

    def ask(self, speed_m_s: float, curvature: float) -> None:
        """Take in what is wanted from now on; see `Session.travel`.

        Raises:
            ValueError: if either is not a finite number.
        """
        if not (math.isfinite(speed_m_s) and math.isfinite(curvature)):
            raise ValueError(f"travel needs finite numbers, not {speed_m_s} m/s, {curvature} 1/m")
        self._wanted = speed_m_s, curvature

    def allowed(self, trace: Trace, known: Known, tracks: OnTracks, *, gate_open: bool) -> Travel:
        """Return how fast it may travel now, and why not as fast as wanted.

        Args:
            trace: of this tick. known: what it was given. tracks: what the machine is believed to stand on.
        """
        wanted, curvature = self._wanted
        if not wanted:
            return Travel(curvature=curvature)
        place, rails = self._setting.place, None
        own = self._setting.follower.track(tracks.own)
        if known.pose is not None and own is not None and isinstance(place, RailPlace):
            rails = believed_place(known.pose, place.network, own)
        speed, reasons = allowed_travel(wanted, curvature, trace, known, rails, self._ground, gate_open)
        return Travel(wanted, speed, curvature=curvature, reasons=reasons)
