"""A small LandXML writer for tests, and the folder of real files."""

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest

from workgauge.site.alignment import Alignment
from workgauge.site.plan import PlanElement, PlanGeometry
from workgauge.site.transitions import Law
from workgauge.values.limits import Source

REAL = Path(__file__).parents[2].parent / "shared" / "data" / "landxml"
NAMES = {
    Law.CLOTHOID: "clothoid",
    Law.BLOSS: "bloss",
    Law.COSINE: "cosine",
    Law.SINE: "sinusoid",
    Law.BIQUADRATIC: "biquadraticParabola",
    Law.CUBIC_PARABOLA: "cubicParabola",
}


@dataclass
class Writer:
    """Writes LandXML text; every part can be replaced to make it wrong."""

    namespace: str = ' xmlns="http://www.landxml.org/schema/LandXML-1.2"'
    units: str = '<Units><Metric linearUnit="meter" directionUnit="radians"/></Units>'
    crs: str = '<CoordinateSystem name="GK21" epsgCode="3875"/>'
    origin: tuple[float, float] = (21_530_000.0, 6_783_000.0)
    parts: list[str] = field(default_factory=list)

    def document(self, *parts: str) -> str:
        body = "\n".join([self.units, self.crs, *parts])
        return (
            f'<?xml version="1.0" encoding="UTF-8"?>\n<LandXML{self.namespace} version="1.2">\n{body}\n</LandXML>\n'
        )

    def place(self, tag: str, e: float, n: float, *height: float) -> str:
        numbers = [n + self.origin[1], e + self.origin[0], *height]
        return f"<{tag}>{' '.join(f'{v:.7f}' for v in numbers)}</{tag}>"

    def element(self, item: PlanElement, *, pi: bool = True, shift: tuple[float, float] = (0.0, 0.0)) -> str:
        """Return one element of a plan; `shift` moves its stated end."""
        end, yaw1 = item.end(), item.end_yaw()
        ends = self.place("Start", *item.start), self.place("End", end[0] + shift[0], end[1] + shift[1])
        rot = "ccw" if (item.k0 or item.k1) > 0 else "cw"
        if item.kind == "line":
            return f'<Line length="{item.length:.6f}">{"".join(ends)}</Line>'
        if item.kind == "curve":
            radius = 1 / item.k0
            centre = (item.start[0] - radius * np.sin(item.yaw), item.start[1] + radius * np.cos(item.yaw))
            middle = self.place("Center", *centre)
            return (
                f'<Curve rot="{rot}" radius="{abs(radius):.6f}" length="{item.length:.6f}">'
                f"{ends[0]}{middle}{ends[1]}</Curve>"
            )
        radii = ["INF" if k == 0 else f"{abs(1 / k):.6f}" for k in (item.k0, item.k1)]
        tangents = np.array([[np.cos(item.yaw), -np.cos(yaw1)], [np.sin(item.yaw), -np.sin(yaw1)]])
        meet = np.linalg.solve(tangents, np.array(end) - item.start)[0] if pi else 0.0
        point = self.place("PI", item.start[0] + meet * np.cos(item.yaw), item.start[1] + meet * np.sin(item.yaw))
        return (
            f'<Spiral spiType="{NAMES[item.law]}" rot="{rot}" length="{item.length:.6f}" '
            f'radiusStart="{radii[0]}" radiusEnd="{radii[1]}">{ends[0]}{point if pi else ""}{ends[1]}</Spiral>'
        )

    def alignment(self, *elements: str, name: str = "Track 1", attributes: str = "", rest: str = "") -> str:
        sta = "" if "staStart" in attributes else ' staStart="0"'
        return (
            f'<Alignments><Alignment name="{name}"{sta}{attributes}><CoordGeom>\n'
            + "\n".join(elements)
            + f"\n</CoordGeom>{rest}</Alignment></Alignments>"
        )

    def surface(self, points: list[tuple[int, str]], faces: list[str], *, attributes: str = "") -> str:
        rows = "\n".join(f'<P id="{i}">{text}</P>' for i, text in points)
        return (
            f'<Surfaces><Surface name="ground"><Definition surfType="TIN"{attributes}><Pnts>{rows}</Pnts>'
            f"<Faces>{''.join(faces)}</Faces></Definition></Surface></Surfaces>"
        )


def chain(*rows: tuple[str, Law, float, float, float], yaw: float = 0.4) -> list[PlanElement]:
    """Return elements (kind, law, length, k0, k1) that meet without gap or kink."""
    elements: list[PlanElement] = []
    for kind, law, length, k0, k1 in rows:
        start = elements[-1].end() if elements else (12.5, -31.25)
        heading = elements[-1].end_yaw() if elements else yaw
        elements.append(PlanElement(kind, law, start, heading, float(length), k0, k1))
    return elements


def track(law: Law = Law.CLOTHOID) -> list[PlanElement]:
    """Return a track with every kind of element, both ways round."""
    return chain(
        ("line", Law.CONSTANT, 120.0, 0.0, 0.0),
        ("spiral", law, 80.0, 0.0, 1 / 600),
        ("curve", Law.CONSTANT, 300.0, 1 / 600, 1 / 600),
        ("spiral", law, 70.0, 1 / 600, 1 / 350),
        ("curve", Law.CONSTANT, 150.0, 1 / 350, 1 / 350),
        ("spiral", law, 60.0, 1 / 350, 0.0),
        ("spiral", law, 60.0, 0.0, -1 / 400),
        ("curve", Law.CONSTANT, 200.0, -1 / 400, -1 / 400),
        ("spiral", law, 90.0, -1 / 400, 0.0),
        ("line", Law.CONSTANT, 50.0, 0.0, 0.0),
    )


def build(elements: list[PlanElement], **parts: object) -> Alignment:
    """Return an alignment of plan elements far from the origin of the coordinates."""
    plan = PlanGeometry((21_530_000.0, 6_783_000.0), elements)
    return Alignment(name="Track 1", source=Source("test", "Track 1"), plan=plan, **parts)  # type: ignore[arg-type]


class Tools:
    """What tests of this folder share."""

    Writer = Writer
    chain = staticmethod(chain)
    track = staticmethod(track)
    build = staticmethod(build)


@pytest.fixture(scope="session")
def tools() -> type[Tools]:
    return Tools


@pytest.fixture
def read(tmp_path):
    """Return a function that reads a document of the given text (or bytes) and optionally more files."""
    from workgauge.site.read import read_site

    def read_text(*texts: str | bytes, epsg: int | None = None):
        paths = []
        for i, text in enumerate(texts):
            path = tmp_path / f"site{i}.xml"
            path.write_bytes(text if isinstance(text, bytes) else text.encode())
            paths.append(path)
        return read_site(paths, epsg=epsg)

    return read_text


@pytest.fixture(scope="session")
def real() -> Path:
    if not REAL.is_dir():
        pytest.skip(f"real files absent: {REAL}")
    return REAL
