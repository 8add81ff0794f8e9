"""Write the shipped example site: 1.2 km of electrified double track in a left-hand curve, as Inframodel LandXML.

    python examples/make_double_track_site.py [--out DIR]

The geometry is evaluated in `double_track_geometry`; here it only becomes text. The same bytes come out every time.
"""

import argparse
import math
from collections.abc import Iterable, Sequence
from itertools import pairwise
from pathlib import Path
from xml.sax.saxutils import quoteattr

import double_track_geometry as geometry
import numpy as np
from double_track_geometry import ORIGIN, Element, Floats, Place, Terrain, Track

OUT = Path(__file__).resolve().parent.parent / "src" / "workgauge" / "shipped" / "sites" / "double_track"
DATE, TIME = "2025-03-14", "12:00:00"
DRAIN_DIAMETER = 0.16

HEADER = f"""<?xml version="1.0" encoding="UTF-8"?>
<LandXML xmlns="http://www.inframodel.fi/inframodel" version="1.2" date="{DATE}" time="{TIME}" language="english" \
readOnly="false">
  <Units>
    <Metric areaUnit="squareMeter" linearUnit="meter" volumeUnit="cubicMeter" temperatureUnit="celsius" \
pressureUnit="HPA" diameterUnit="meter" widthUnit="meter" heightUnit="meter" velocityUnit="kilometersPerHour" \
angularUnit="grads" directionUnit="grads" elevationUnit="meter"/>
  </Units>
  <CoordinateSystem name="ETRS89 / GK25FIN" epsgCode="3879" rotationAngle="0" verticalCoordinateSystemName="N2000"/>
  <FeatureDictionary name="inframodel" version="4.0.3"/>
  <Project name="Double track" desc="Invented example site, not a survey">
    <Feature code="IM_codings" source="inframodel" name="classcodings">
      <Property label="terrainCoding" value="InfraBIM"/>
      <Property label="surfaceCoding" value="InfraBIM"/>
      <Property label="infraCoding" value="Double track example"/>
    </Feature>
  </Project>
  <Application name="make_double_track_site" desc="Example site of workgauge"/>
"""


def attributes(**values: str | float) -> str:
    """Return XML attributes; numbers with six decimals."""
    texts = {key: value if isinstance(value, str) else f"{value:.6f}" for key, value in values.items()}
    return " ".join(f"{key}={quoteattr(text)}" for key, text in texts.items())


def plan(point: Sequence[float] | Floats) -> str:
    """Return `northing easting` of a local plan point."""
    return f"{ORIGIN[1] + point[1]:.6f} {ORIGIN[0] + point[0]:.6f}"


def space(point: Sequence[float] | Floats, decimals: int = 3) -> str:
    """Return `northing easting height` of a local point."""
    return " ".join(f"{value:.{decimals}f}" for value in (ORIGIN[1] + point[1], ORIGIN[0] + point[0], point[2]))


def gons(yaw: float) -> float:
    """Return a direction counter-clockwise from north [gon] in [0, 400)."""
    return (yaw - math.pi / 2) * 200 / math.pi % 400


def coding(kind: str, code: str, desc: str) -> str:
    """Return the classification feature of an element; kind is terrain, surface or infra."""
    code, desc = attributes(label=f"{kind}Coding", value=code), attributes(label=f"{kind}CodingDesc", value=desc)
    return f'<Feature code="IM_coding" source="inframodel"><Property {code}/><Property {desc}/></Feature>'


def element_xml(element: Element, station: float, name: str) -> str:
    """Return one plan element; the curve is left-hand throughout."""
    x, y, yaw, _ = element.at(element.length)[0]
    ends = f"<Start>{plan((element.x, element.y))}</Start>", f"<End>{plan((x, y))}</End>"
    common = attributes(name=name, staStart=station, length=element.length)
    if element.k0 == element.k1 == 0:
        return f"        <Line {common} {attributes(dir=gons(element.yaw))}>{ends[0]}{ends[1]}</Line>\n"
    if element.k0 == element.k1:
        radius = 1 / element.k0
        centre = (element.x - radius * math.sin(element.yaw), element.y + radius * math.cos(element.yaw))
        extra = attributes(rot="ccw", radius=radius, chord=math.hypot(x - element.x, y - element.y))
        return f"        <Curve {common} {extra}>{ends[0]}<Center>{plan(centre)}</Center>{ends[1]}</Curve>\n"
    radii = ["INF" if k == 0 else f"{1 / k:.6f}" for k in (element.k0, element.k1)]
    # The tangents' intersection, from the start along its tangent.
    turn, dx, dy = yaw - element.yaw, x - element.x, y - element.y
    ahead = (dx * math.sin(yaw) - dy * math.cos(yaw)) / math.sin(turn)
    corner = (element.x + ahead * math.cos(element.yaw), element.y + ahead * math.sin(element.yaw))
    extra = attributes(
        radiusStart=radii[0],
        radiusEnd=radii[1],
        rot="ccw",
        spiType="clothoid",
        constant=math.sqrt(element.length / max(element.k0, element.k1)),
        dirStart=gons(element.yaw),
        dirEnd=gons(yaw),
    )
    return f"        <Spiral {common} {extra}>{ends[0]}<PI>{plan(corner)}</PI>{ends[1]}</Spiral>\n"


def profile_xml(track: Track) -> str:
    """Return the profile: intersection points, and circles by their arc length (radius > 0 is a sag)."""
    stations, levels, _ = np.array(track.pvis).T
    slopes = np.arctan(np.diff(levels) / np.diff(stations))
    lines = [f"          <PVI>{stations[0]:.6f} {levels[0]:.6f}</PVI>\n"]
    for (station, level, radius), before, after in zip(track.pvis[1:-1], slopes[:-1], slopes[1:], strict=True):
        circle = attributes(length=abs(radius * (after - before)), radius=radius)
        lines.append(f"          <CircCurve {circle}>{station:.6f} {level:.6f}</CircCurve>\n")
    lines.append(f"          <PVI>{stations[-1]:.6f} {levels[-1]:.6f}</PVI>\n")
    return "".join(lines)


def tracks_xml(tracks: Sequence[Track]) -> str:
    """Return both alignments."""
    parts = ['  <Alignments name="Double track" desc="Track centre lines" state="existing">\n']
    for track in tracks:
        head = attributes(name=track.name, desc="Track centre line", staStart=0.0, length=track.length)
        parts.append(f'    <Alignment {head} state="existing">\n      <CoordGeom>\n')
        for index, (element, station) in enumerate(zip(track.elements, track.starts[:-1], strict=True), start=1):
            parts.append(element_xml(element, float(station), f"{track.name[-1]}.{index}"))
        parts.append('      </CoordGeom>\n      <Cant name="Cant" gauge="1.524" rotationPoint="insideRail">\n')
        for station, cant in track.cants:
            parts.append(
                f"        <CantStation {attributes(station=station, appliedCant=float(cant), curvature='ccw')}/>\n"
            )
        parts.append(f'      </Cant>\n      <Profile>\n        <ProfAlign name="{track.name}">\n{profile_xml(track)}')
        meaning = {"111": "Pituusmittausraide", "281": "Raiteen keskilinja"}[track.code]
        parts.append(f"        </ProfAlign>\n      </Profile>\n      {coding('terrain', track.code, meaning)}\n")
        parts.append("    </Alignment>\n")
    return "".join([*parts, "  </Alignments>\n"])


def points_xml(group: str, name: str, code: str, desc: str, places: Iterable[Place]) -> str:
    """Return a group of points."""
    lines = [
        f"      <CgPoint {attributes(name=place.name, code=code, desc=desc)}>{space(place.position)}</CgPoint>\n"
        for place in places
    ]
    head = attributes(name=name, code=code, desc=desc)
    return (
        f"  <CgPoints {attributes(name=group)}>\n    <CgPoints {head}>\n{''.join(lines)}"
        f"      {coding('infra', code, desc)}\n    </CgPoints>\n  </CgPoints>\n"
    )


def polyline_xml(name: str, code: str, desc: str, points: Floats) -> str:
    """Return a plan feature along a polyline."""
    texts = [space(point) for point in points]
    return (
        f"    <PlanFeature {attributes(name=name, desc=desc)}>\n      <CoordGeom>\n        <IrregularLine>\n"
        f"          <Start>{texts[0]}</Start>\n          <End>{texts[-1]}</End>\n"
        f"          <PntList3D>{' '.join(texts)}</PntList3D>\n        </IrregularLine>\n      </CoordGeom>\n"
        f"      {coding('infra', code, desc)}\n    </PlanFeature>\n"
    )


def catenary_xml(tracks: Sequence[Track], terrain: Terrain) -> str:
    """Return the poles and the contact wires."""
    poles = [pole for track in tracks for pole in geometry.make_poles(track, terrain)]
    wires = "".join(
        polyline_xml(
            f"Contact wire {track.name[-1]}", "OVERHEAD_LINE_25KV", "Overhead line 25 kV", geometry.make_wire(track)
        )
        for track in tracks
    )
    return (
        points_xml("Electrification", "Catenary poles", "CATENARY_POLE", "Catenary pole", poles)
        + f'  <PlanFeatures name="Overhead lines">\n{wires}  </PlanFeatures>\n'
    )


def drain_xml(wells: Sequence[Place], terrain: Terrain) -> str:
    """Return the drain: wells at pipe inverts, pipes `D..` between consecutive wells."""
    rims = terrain.height(np.array([well.position[:2] for well in wells]))
    structs, pipes = [], []
    for index, (well, rim) in enumerate(zip(wells, rims, strict=True)):
        invert = f"{well.position[2]:.3f}"
        inverts = "".join(
            f"<Invert {attributes(elev=invert, flowDir='both', refPipe=f'D{pipe:02d}')}/>"
            for pipe in (index, index + 1)
            if 0 < pipe < len(wells)
        )
        head = attributes(name=well.name, desc="Drain well", elevRim=f"{rim:.3f}", elevSump=invert)
        centre = f"<Center>{space(well.position)}</Center>"
        structs.append(f'        <Struct {head}>{centre}<CircStruct diameter="0.400"/>{inverts}</Struct>\n')
    for index, (a, b) in enumerate(pairwise(wells), start=1):
        head = attributes(name=f"D{index:02d}", desc="Drain pipe", refStart=a.name, refEnd=b.name)
        step = b.position - a.position
        size = attributes(length=float(np.hypot(*step[:2])), slope=float(step[2] / np.hypot(*step[:2])))
        feature = coding("infra", "DRAIN_PIPE", "Drain pipe")
        pipes.append(
            f'        <Pipe {head} {size}><CircPipe diameter="{DRAIN_DIAMETER:.3f}" material="PE"/>{feature}</Pipe>\n'
        )
    return (
        '  <PipeNetworks name="Drainage">\n    <PipeNetwork name="Drain" desc="Drain pipe" pipeNetType="storm">\n'
        f"      <Structs>\n{''.join(structs)}      </Structs>\n      <Pipes>\n{''.join(pipes)}      </Pipes>\n"
        f"      {coding('infra', 'DRAIN_PIPE', 'Drain pipe')}\n    </PipeNetwork>\n  </PipeNetworks>\n"
    )


def trackside_xml(first: Track, second: Track, terrain: Terrain) -> str:
    """Return signals, cable and drain."""
    cable = polyline_xml("Cable 1", "CABLE", "Signalling cable", geometry.make_cable(second, terrain))
    signals = geometry.make_signals(first, second, terrain)
    return (
        points_xml("Signalling", "Signals", "SIGNAL", "Signal", signals)
        + f'  <PlanFeatures name="Cables">\n{cable}  </PlanFeatures>\n'
        + drain_xml(geometry.make_wells(first), terrain)
    )


def terrain_xml(terrain: Terrain) -> str:
    """Return the surface."""
    points = "".join(f'          <P id="{k}">{space(p)}</P>\n' for k, p in enumerate(terrain.vertices, start=1))
    faces = "".join(f"          <F>{a} {b} {c}</F>\n" for a, b, c in (terrain.faces + 1).tolist())
    return (
        '  <Surfaces name="Terrain">\n    <Surface name="Terrain" desc="Terrain">\n'
        f'      <Definition surfType="TIN">\n        <Pnts>\n{points}        </Pnts>\n        <Faces>\n{faces}'
        "        </Faces>\n      </Definition>\n"
        f"      {coding('surface', '1', 'Terrain')}\n    </Surface>\n  </Surfaces>\n"
    )


def make_files() -> dict[str, bytes]:
    """Return the site's files by name."""
    first, second = geometry.make_tracks()
    terrain = geometry.make_terrain(first, second)
    bodies = {
        "tracks.xml": tracks_xml((first, second)),
        "catenary.xml": catenary_xml((first, second), terrain),
        "trackside.xml": trackside_xml(first, second, terrain),
        "terrain.xml": terrain_xml(terrain),
    }
    return {name: f"{HEADER}{body}</LandXML>\n".encode() for name, body in bodies.items()}


def main() -> None:
    """Write the files."""
    parser = argparse.ArgumentParser(description="Write the shipped double-track site.")
    parser.add_argument("--out", type=Path, default=OUT, help="folder to write into")
    out = parser.parse_args().out
    out.mkdir(parents=True, exist_ok=True)
    for name, content in make_files().items():
        (out / name).write_bytes(content)
        print(f"{out / name}: {len(content):,} bytes")


if __name__ == "__main__":
    main()
