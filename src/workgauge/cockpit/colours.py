"""Colours of the scene, apart for every kind of colour blindness (after Okabe and Ito), and of the page's charts."""

from workgauge.values.limits import LimitKind

Rgb = tuple[int, int, int]

#: Colour and opacity of limits by kind.
LIMITS: dict[LimitKind, tuple[Rgb, float | None]] = {
    LimitKind.TRACK: ((213, 94, 0), 0.22),
    LimitKind.OVERHEAD_LINE: ((230, 159, 0), 0.09),
    LimitKind.POINT: ((0, 114, 178), None),
    LimitKind.LINE: ((0, 158, 115), None),
    LimitKind.SURFACE: ((150, 143, 130), None),
    LimitKind.ZONE: ((204, 121, 167), 0.35),
}
MACHINE: Rgb = (236, 196, 60)
UNDERCARRIAGE: Rgb = (92, 98, 106)
#: Of the predicted stop, and of a preview.
STOP_GHOST: Rgb = (86, 180, 233)
PREVIEW_GHOST: Rgb = (0, 158, 115)
RAIL: Rgb = (84, 88, 94)
HALO: Rgb = (204, 121, 167)

#: Clearance lines by what is left above what must be kept [m]: to stop, to slow, enough.
NEAR: tuple[tuple[float, Rgb], ...] = ((0.05, (213, 94, 0)), (0.6, (230, 159, 0)), (1e9, (0, 114, 178)))


def near_colour(left_m: float) -> Rgb:
    """Return the colour of a clearance with that much left."""
    return next(colour for below, colour in NEAR if left_m < below)
