"""Units of a LandXML file; everything that leaves the reader is in metres and radians."""

from dataclasses import dataclass

from workgauge.site.landxml.blocks import line_of
from workgauge.site.landxml.document import Document, child
from workgauge.site.units import LINEAR_UNITS, linear_unit

#: Angle units LandXML knows; angles are only cross-checks here, so an unknown one is a warning.
_ANGLES = ("radians", "grads", "decimal degrees", "decimal dd.mm.ss")


@dataclass(frozen=True, slots=True)
class FileUnits:
    """Factors into metres, and the names as the file gives them.

    Attributes:
        linear: of coordinates, stations, lengths and radii. elevation: of heights. diameter: of pipes.
        system: `Metric`, `Imperial`, or None if the file does not say.
        names: what to tell people.
    """

    linear: float
    elevation: float
    diameter: float
    system: str | None
    names: dict[str, str]


def read_units(document: Document) -> FileUnits:
    """Return the units of a file; without any, metres are assumed with a warning.

    Raises:
        SiteError: an unknown linear unit, or an imperial file that does not say which foot.
    """
    units = child(document.root, "Units")
    metric = None if units is None else child(units, "Metric")
    system = metric if metric is not None or units is None else child(units, "Imperial")
    if system is None:
        document.warn("states no units; metres are assumed")
        return FileUnits(1.0, 1.0, 1.0, None, {"linear": "meter", "elevation": "meter"})
    kind = "Imperial" if metric is None else "Metric"

    def unit(key: str, default: str | None) -> str:
        text = system.get(key) or default
        if text is None:
            raise document.error(f"states no {key}", system, allowed=", ".join(LINEAR_UNITS))
        known = linear_unit(text)
        if known is None:
            raise document.error(f"unknown {key}", system, value=text, allowed=", ".join(LINEAR_UNITS))
        return known

    linear = unit("linearUnit", "meter" if kind == "Metric" else None)
    if system.get("linearUnit") is None:
        document.warn("states no linear unit; metres are assumed", "Metric", line_of(system))
    names = {"linear": linear, "elevation": unit("elevationUnit", linear)}
    if abs(LINEAR_UNITS[names["elevation"]] / LINEAR_UNITS[linear] - 1) > 1e-3:
        document.warn(f"heights are read in {names['elevation']}, the rest in {linear}", kind, line_of(system))
    if system.get("diameterUnit"):
        names["diameter"] = unit("diameterUnit", linear)
    for key, name in (("angularUnit", "angular"), ("directionUnit", "direction")):
        text = system.get(key)
        if text:
            names[name] = text
            if text not in _ANGLES:
                document.warn(f"unknown {key} {text!r}; angles are not used", kind, line_of(system))
    return FileUnits(
        LINEAR_UNITS[linear],
        LINEAR_UNITS[names["elevation"]],
        LINEAR_UNITS[names.get("diameter", linear)],
        kind,
        names,
    )
