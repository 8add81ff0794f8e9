"""Length units of site files, by the names LandXML uses."""

#: Length of each linear unit [m]. `foot` is the international foot.
LINEAR_UNITS: dict[str, float] = {
    "millimeter": 0.001,
    "centimeter": 0.01,
    "decimeter": 0.1,
    "meter": 1.0,
    "kilometer": 1000.0,
    "foot": 0.3048,
    "USSurveyFoot": 1200 / 3937,
    "inch": 0.0254,
    "mile": 1609.344,
}

#: Other spellings seen in files.
ALIASES: dict[str, str] = {
    "metre": "meter",
    "millimetre": "millimeter",
    "centimetre": "centimeter",
    "decimetre": "decimeter",
    "kilometre": "kilometer",
    "feet": "foot",
    "internationalfoot": "foot",
    "ussurveyfoot": "USSurveyFoot",
    "ussurveyfeet": "USSurveyFoot",
    "inches": "inch",
    "miles": "mile",
}


def linear_unit(name: str) -> str | None:
    """Return the known name of a linear unit, or None if there is no such unit."""
    if name in LINEAR_UNITS:
        return name
    plain = "".join(c for c in name.casefold() if c.isalnum())
    return ALIASES.get(plain, plain if plain in LINEAR_UNITS else None)
