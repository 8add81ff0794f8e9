"""What a file holds that the reader does not read: counted by element, so that nothing is dropped in silence."""

from collections.abc import Iterator

from workgauge.site.landxml.blocks import line_of
from workgauge.site.landxml.document import Document, Element, local

#: By element, which elements inside it are read; what stands in neither table is counted as not read.
READ: dict[str, tuple[str, ...]] = {
    "LandXML": ("Units", "CoordinateSystem", "Alignments", "Surfaces", "CgPoints", "PlanFeatures", "PipeNetworks"),
    "Alignments": ("Alignment",),
    "Alignment": ("CoordGeom", "Profile", "Cant", "StaEquation"),
    "CoordGeom": ("Line", "Curve", "Spiral", "IrregularLine", "Chain"),
    "Profile": ("ProfAlign",),
    "ProfAlign": ("PVI", "ParaCurve", "UnsymParaCurve", "CircCurve"),
    "Cant": ("CantStation",),
    "Surfaces": ("Surface",),
    "Surface": ("Definition", "SourceData"),
    "Definition": ("Pnts", "Faces"),
    "SourceData": ("DataPoints", "Breaklines", "Contours", "Boundaries"),
    "DataPoints": ("Pnts", "PntList3D"),
    "Contours": ("Contour",),
    "Contour": ("PntList2D", "PntList3D"),
    "Breaklines": ("Breakline",),
    "Boundaries": ("Boundary",),
    "CgPoints": ("CgPoint", "CgPoints"),
    "PlanFeatures": ("PlanFeature",),
    "PlanFeature": ("CoordGeom", "Location"),
    "PipeNetworks": ("PipeNetwork",),
    "PipeNetwork": ("Structs", "Pipes"),
    "Structs": ("Struct",),
    "Struct": ("Center", "Invert", "CircStruct", "InletStruct", "OutletStruct"),
    "Pipes": ("Pipe",),
    "Pipe": ("CircPipe", "Center"),
    # Only frames for what is read or counted inside them.
    "Roadways": ("Roadway",),
    "Roadway": ("PlanFeatures",),
    "Roadside": (),
    "Survey": ("CgPoints",),
}
#: Frames that hold nothing of their own.
_FRAMES = ("Roadways", "Roadway", "Roadside", "Survey")
#: Who made the file and when, codes (read with their owners), copies of what is read, speeds and flows.
NOT_OF_THE_SITE = (
    "Project",
    "Application",
    "FeatureDictionary",
    "Amendment",
    "Author",
    "DocFileRef",
    "FieldNote",
    "Feature",
    "AlignPIs",
    "SpeedStation",
    "Speeds",
    "Classification",
    "Connection",
    "PipeFlow",
    "StructFlow",
)


def count_unread(document: Document) -> dict[str, int]:
    """Warn, once for each kind of element, of what is not read; return the counts."""
    found: dict[str, list[Element]] = {}
    for element in _unread(document.root):
        found.setdefault(local(element), []).append(element)
    for name, elements in found.items():
        many = "s are" if len(elements) > 1 else " is"
        document.warn(f"{len(elements)} {name} element{many} not read", line=line_of(elements[0]))
    return {name: len(elements) for name, elements in found.items()}


def _unread(element: Element) -> Iterator[Element]:
    read = READ.get(local(element), ())
    for inner in element:
        name = local(inner)
        if name in read or name in _FRAMES:
            if name in READ:
                yield from _unread(inner)
        elif name not in NOT_OF_THE_SITE:
            yield from _singles(inner)


def _singles(element: Element) -> Iterator[Element]:
    """Yield what an unknown element is a list of (`RoadSign` in `RoadSigns`), or else itself."""
    kinds = {local(inner) for inner in element}
    if len(kinds) == 1 and local(element) == f"{next(iter(kinds))}s":
        yield from element
    else:
        yield element
