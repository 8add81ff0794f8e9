"""The page on site files is true: its example runs, its thresholds are the code's, its elements are the reader's."""

import doctest
import re
from pathlib import Path

import pytest

from workgauge.geodesy.crs import AREA_MARGIN_DEG
from workgauge.site.landxml import cant, census, elements, heights, lines, numbers, plan
from workgauge.site.profile import OVERLAP_SLACK_M
from workgauge.site.units import LINEAR_UNITS

PAGE = Path(__file__).parents[2] / "docs" / "site-files.md"


def test_the_example_runs() -> None:
    failed, tried = doctest.testfile(str(PAGE), module_relative=False)
    assert tried >= 8 and not failed


@pytest.mark.parametrize(
    ("row", "told", "refused"),
    [
        ("misses its stated end", f"{1000 * plan.MISCLOSURE_WARN_M:g} mm", f"{1000 * plan.MISCLOSURE_LIMIT_M:g} mm"),
        ("gap between elements", f"{1000 * plan.GAP_WARN_M:g} mm", f"{1000 * plan.GAP_LIMIT_M:g} mm"),
        ("kink between elements", f"{plan.KINK_WARN_RAD:g} rad", f"{plan.KINK_LIMIT_RAD:g} rad"),
        ("stated length or radius", f"{1000 * plan.LENGTH_WARN_M:g} mm", ""),
        ("length of an alignment", f"{1000 * plan.LENGTH_WARN_M:g} mm", ""),
        ("vertical curves that overlap", "", f"{OVERLAP_SLACK_M:g} m"),
        ("largest cant ", "", f"{cant.LARGEST_CANT_M:g} m"),
        ("largest cant, in mill", "", f"{1000 * cant.SMALLEST_CANT_M:g} mm"),
        (
            "diameter ",
            f"{lines.DIAMETER_WARN_M:g} m",
            f"{lines.SMALLEST_DIAMETER_M:g} to {lines.LARGEST_DIAMETER_M:g} m",
        ),
        ("heights, from the median", f"{heights.HEIGHT_SPREAD_M:g} m", f"{elements.LARGEST_M:.0e}".replace("+0", "")),
        ("easting, northing", "", f"{elements.LARGEST_M:.0e}".replace("+0", "")),
        ("any other number", "", f"{numbers.LARGEST:.0e}".replace("+", "")),
        ("radius of a curve", "", f"{elements.SMALLEST_RADIUS_M:g} m"),
    ],
)
def test_the_thresholds_are_the_codes(row: str, told: str, refused: str) -> None:
    (found,) = re.findall(rf"^\| [^|]*{row}[^|]*\| ([^|]*)\| ([^|]*)\|$", PAGE.read_text(), re.MULTILINE)
    assert told in found[0] and refused in found[1]
    assert bool(told) == bool(found[0].strip()) and bool(refused) == bool(found[1].strip())


def test_the_other_figures_are_the_codes() -> None:
    text = PAGE.read_text()
    assert f"more than {AREA_MARGIN_DEG:g} degree outside" in text
    assert f"chords at most {1000 * lines.CHORD_ERROR_M:g} mm off" in text
    assert all(name in text for name in LINEAR_UNITS)
    plain = text.casefold()
    assert all(name in plain for name in ("clothoid", *elements.SPIRAL_TYPES))


def test_every_element_that_is_read_is_named() -> None:
    text = PAGE.read_text()
    frames = {
        "Alignments",
        "Surfaces",
        "PlanFeatures",
        "PipeNetworks",
        "Pipes",
        "Structs",
        "SourceData",
        "Breaklines",
    }
    quiet = {"Boundaries", "Units", "CoordinateSystem", "InletStruct", "OutletStruct", "Invert", "Roadway", "LandXML"}
    read = {name for inside in census.READ.values() for name in inside} - frames - quiet
    assert {name for name in read if f"`{name}`" not in text and f"/{name}" not in text and name not in text} == set()
