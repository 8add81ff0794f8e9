"""Feature codes and properties, as Inframodel hangs them on every element."""

from workgauge.site.landxml.document import Element, children

#: Labels whose value is an element's code, the most telling first.
_CODE_LABELS = ("infraCoding", "terrainCoding", "surfaceCoding", "proprietaryInfraCoding")


def feature_codes(element: Element) -> dict[str, str]:
    """Return the properties of the element's own features by label; the first of each label counts."""
    found: dict[str, str] = {}
    for feature in children(element, "Feature"):
        for prop in children(feature, "Property"):
            key, value = prop.get("label"), prop.get("value")
            if key and value is not None:
                found.setdefault(key, value)
    return found


def feature_names(element: Element) -> list[str]:
    """Return the codes and names of the element's own features (`IM_coding`, `IM_cable` ...)."""
    return [f.get(key) or "" for f in children(element, "Feature") for key in ("code", "name") if f.get(key)]


def code_of(element: Element, properties: dict[str, str]) -> str | None:
    """Return the element's own `code`, or else the coding its features give, or None."""
    own = (element.get("code") or "").strip()
    if own:
        return own
    return next((properties[key] for key in _CODE_LABELS if properties.get(key)), None)
