"""What is said of heights that were made up: one sentence per cause, with the count, the names and the heights."""

from collections.abc import Iterable, Sequence

from workgauge.gauge.heights import Origin, SiteHeights
from workgauge.gauge.match import Feature

#: How many names a warning spells out.
NAMED = 5

_WITHOUT = {
    "alignment": "no profile, or one shorter than {they}",
    "point": "no height",
    "line": "no height, or none for a part",
    "overhead line": "no height, or none for a part",
}


class MadeUpHeights:
    """Counts features by what they are and where their heights are from."""

    def __init__(self) -> None:
        self._seen: dict[tuple[str, Origin, str], tuple[dict[int, str], list[float]]] = {}

    def see(self, kind: str, feature: Feature, origin: Origin, heights: Iterable[float], remark: str = "") -> None:
        """Take note of a feature's heights [m] from one origin; `remark` goes to the sentence's end."""
        names, known = self._seen.setdefault((kind, origin, remark), ({}, []))
        names[id(feature)] = feature.name.strip()
        values = list(heights)
        if values:
            known[:] = [min([*known, *values]), max([*known, *values])]

    def warnings(self, heights: SiteHeights) -> list[str]:
        """Return the sentences, in the order the causes were first met."""
        out = []
        for (kind, origin, remark), (names, known) in self._seen.items():
            count = len(names)
            without = _WITHOUT[kind].format(they="it is" if count == 1 else "they are")
            have = "has" if count == 1 else "have"
            text = f"{counted(count, kind)} {have} {without}; {_used(origin, known, heights)}{remark}"
            out.append(f"{text}: {listed(list(names.values()))}")
        return out


def _used(origin: Origin, known: Sequence[float], heights: SiteHeights) -> str:
    span = f"{known[0]:.3f} to {known[-1]:.3f} m" if known else ""
    if origin is Origin.SURFACE:
        return f"heights used: the surface's there, {span}"
    if origin is Origin.PROFILE:
        return f"heights used: the nearest profile's within {heights.within:g} m, {span}"
    if origin is Origin.OWN:
        return f"heights used: the feature's own up to {heights.within:g} m along it, {span}"
    if origin is Origin.CONSTANT:
        return (
            f"height used: {heights.constant:.3f} m everywhere (height_without_profile), as the site has no heights"
        )
    return f"guarded at every height, {heights.low:.0f} to {heights.high:.0f} m"


def counted(count: int, noun: str) -> str:
    """Return `1 pole`, `2 poles`."""
    return f"{count} {noun}" if count == 1 else f"{count} {noun}s"


def listed(names: Sequence[str]) -> str:
    """Return the first names in quotes, and how many more there are."""
    shown = ", ".join(repr(name) for name in names[:NAMED])
    return shown if len(names) <= NAMED else f"{shown} and {len(names) - NAMED} more"
