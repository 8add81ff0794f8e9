"""How long reading a site and turning it into limits takes, and how much memory: one JSON object with `--json`.

Jobs, each in a process of its own so that its peak memory is its own:

- `terrain`: a terrain of 36,067 triangles is read (a generated one of like size where the real file is absent);
- `million`: a generated surface of a million triangles is read;
- `double_track`: 100 km of generated double track is read from LandXML and turned into limits.
"""

import argparse
import json
import math
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from workgauge.gauge.build import build_limits
from workgauge.gauge.rulebook import load_rule_book
from workgauge.site.read import read_site

ROOT = Path(__file__).resolve().parent.parent
TERRAIN = ROOT.parent / "shared" / "data" / "landxml" / "inframodel_m3" / "M3_Terrain.mm.xml"
KILOMETRES = 100.0
START = (6_650_000.0, 25_487_000.0)
HEAD = """<?xml version="1.0" encoding="UTF-8"?>
<LandXML xmlns="http://www.inframodel.fi/inframodel" version="1.2" date="2025-01-01" time="12:00:00">
<Units><Metric areaUnit="squareMeter" linearUnit="meter" volumeUnit="cubicMeter" temperatureUnit="celsius"
 pressureUnit="HPA" diameterUnit="meter" widthUnit="meter" heightUnit="meter" angularUnit="grads"
 directionUnit="grads" elevationUnit="meter"/></Units>
<CoordinateSystem name="ETRS89 / GK25FIN" epsgCode="3879" rotationAngle="0" verticalCoordinateSystemName="N2000"/>
<Project name="Benchmark"/>
"""
#: One stretch of track [m]: straight, transition, arc, transition.
STRAIGHT, TRANSITION, ARC = 250.0, 100.0, 300.0
RADII = (600.0, 900.0, 1500.0)


def surface_xml(columns: int, rows: int, path: Path) -> int:
    """Write a gently rolling grid surface and return its number of triangles."""
    j, i = np.meshgrid(np.arange(columns), np.arange(rows))
    north, east = START[0] + 2.0 * i.ravel(), START[1] + 2.0 * j.ravel()
    height = 10.0 + 2.0 * np.sin(i.ravel() / 17.0) * np.cos(j.ravel() / 23.0)
    corner = (i[:-1, :-1] * columns + j[:-1, :-1] + 1).ravel()
    with path.open("w", encoding="ascii") as out:
        out.write(HEAD + '<Surfaces><Surface name="Grid"><Definition surfType="TIN"><Pnts>\n')
        points = zip(north.tolist(), east.tolist(), height.tolist(), strict=True)
        out.writelines(f'<P id="{k}">{n:.3f} {e:.3f} {z:.3f}</P>\n' for k, (n, e, z) in enumerate(points, 1))
        out.write("</Pnts><Faces>\n")
        for c in corner.tolist():
            out.write(f"<F>{c} {c + 1} {c + columns + 1}</F>\n<F>{c} {c + columns + 1} {c + columns}</F>\n")
        out.write("</Faces></Definition></Surface></Surfaces></LandXML>\n")
    return 2 * len(corner)


class TrackWriter:
    """Writes plan elements one after another from a point and a direction (counter-clockwise from north)."""

    def __init__(self, north: float, east: float) -> None:
        self.n, self.e, self.angle, self.station = north, east, 0.0, 0.0
        self.plan: list[str] = []
        self.cant: list[str] = []

    def element(self, length: float, start: float, end: float, sense: str) -> None:
        """Add a piece whose curvature runs linearly from `start` to `end` [1/m], positive to the left."""
        nodes, weights = np.polynomial.legendre.leggauss(24)
        s = (nodes + 1) * length / 2
        angle = self.angle + start * s + (end - start) * s**2 / (2 * length)
        n0, e0 = self.n, self.e
        self.n += float(np.sum(weights * np.cos(angle))) * length / 2
        self.e -= float(np.sum(weights * np.sin(angle))) * length / 2
        begin = f"<Start>{n0:.6f} {e0:.6f}</Start>"
        stop = f"<End>{self.n:.6f} {self.e:.6f}</End>"
        place = f'length="{length:.6f}" staStart="{self.station:.6f}"'
        if start == end == 0:
            self.plan.append(f"<Line {place}>{begin}{stop}</Line>")
        elif start == end:
            cn, ce = n0 - math.sin(self.angle) / start, e0 - math.cos(self.angle) / start
            centre = f"<Center>{cn:.6f} {ce:.6f}</Center>"
            radius = abs(1 / start)
            self.plan.append(f'<Curve rot="{sense}" radius="{radius:.6f}" {place}>{begin}{centre}{stop}</Curve>')
        else:
            first, last = ("INF" if k == 0 else f"{abs(1 / k):.6f}" for k in (start, end))
            radii = f'radiusStart="{first}" radiusEnd="{last}"'
            along = length / 2
            pn, pe = n0 + along * math.cos(self.angle), e0 - along * math.sin(self.angle)
            middle = f"<PI>{pn:.6f} {pe:.6f}</PI>"
            head = f'<Spiral rot="{sense}" spiType="clothoid" {radii} {place}>'
            self.plan.append(f"{head}{begin}{middle}{stop}</Spiral>")
        self.angle += (start + end) / 2 * length
        self.station += length

    def stretch(self, i: int) -> None:
        """Add a straight and a curve with its transitions and cant; curves go left, right, right, left."""
        left = i % 4 in (0, 3)
        k = (1 if left else -1) / RADII[i // 2 % len(RADII)]
        sense = "ccw" if left else "cw"
        self.element(STRAIGHT, 0.0, 0.0, sense)
        for length, start, end, cant in ((TRANSITION, 0.0, k, 0.0), (ARC, k, k, 0.1), (TRANSITION, k, 0.0, 0.1)):
            self.cant.append(
                f'<CantStation station="{self.station:.6f}" appliedCant="{cant:.6f}" curvature="{sense}"/>'
            )
            self.element(length, start, end, sense)
        self.cant.append(f'<CantStation station="{self.station:.6f}" appliedCant="0.000000" curvature="{sense}"/>')

    def xml(self, name: str) -> str:
        """Return the alignment."""
        heights = [f"<PVI>0.000000 {80.0:.6f}</PVI>"]
        for i in range(1, int(self.station // 1000)):
            z, sign = (83.0, "-") if i % 2 else (77.0, "")
            curve = f'<CircCurve length="120.000000" radius="{sign}10000.000000">'
            heights.append(f"{curve}{1000.0 * i:.6f} {z:.6f}</CircCurve>")
        heights.append(f"<PVI>{self.station:.6f} 80.000000</PVI>")
        return (
            f'<Alignment name="{name}" length="{self.station:.6f}" staStart="0.000000"><CoordGeom>\n'
            + "\n".join(self.plan)
            + '\n</CoordGeom>\n<Cant name="C" gauge="1.524" rotationPoint="insideRail">\n'
            + "\n".join(self.cant)
            + '\n</Cant>\n<Profile><ProfAlign name="P">\n'
            + "\n".join(heights)
            + "\n</ProfAlign></Profile></Alignment>\n"
        )


def double_track_xml(kilometres: float, folder: Path) -> list[Path]:
    """Write two parallel tracks of the given length, a file each, and return the files."""
    files = []
    for track in (1, 2):
        writer = TrackWriter(START[0], START[1] + 4.5 * (track - 1))
        i = 0
        while writer.station < kilometres * 1000:
            writer.stretch(i)
            i += 1
        path = folder / f"track{track}.xml"
        text = f'{HEAD}<Alignments name="Tracks">\n{writer.xml(f"Track {track}")}</Alignments></LandXML>\n'
        path.write_text(text, encoding="ascii")
        files.append(path)
    return files


def read_job(files: list[Path]) -> dict[str, Any]:
    """Read surfaces; return counts, time and peak memory."""
    began = time.perf_counter()
    site = read_site(files)
    took = time.perf_counter() - began
    return {
        "points": sum(len(s.vertices) for s in site.surfaces),
        "faces": sum(len(s.faces) for s in site.surfaces),
        "read_s": round(took, 3),
        "peak_rss_mb": peak_rss_mb(),
    }


def limits_job(files: list[Path]) -> dict[str, Any]:
    """Read tracks and turn them into limits; return counts, times and peak memory."""
    book = load_rule_book("finland")
    began = time.perf_counter()
    site = read_site(files)
    middle = time.perf_counter()
    limits = build_limits(site, book)
    ended = time.perf_counter()
    return {
        "track_km": round(sum(a.length for a in site.alignments) / 1000, 3),
        "limits": len(limits.limits),
        "cells": sum(len(limit.solid) for limit in limits.limits if hasattr(limit.solid, "__len__")),
        "read_s": round(middle - began, 3),
        "limits_s": round(ended - middle, 3),
        "total_s": round(ended - began, 3),
        "peak_rss_mb": peak_rss_mb(),
    }


def peak_rss_mb() -> float:
    """Return this process's peak resident memory [MB of 1e6 bytes]."""
    return round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 / 1e6, 1)


def in_process(job: str, files: list[Path]) -> dict[str, Any]:
    """Run a job in a process of its own and return its object."""
    command = [sys.executable, str(Path(__file__).resolve()), "--job", job, *map(str, files)]
    done = subprocess.run(command, check=True, capture_output=True, text=True)
    result: dict[str, Any] = json.loads(done.stdout)
    return result


def run(kilometres: float) -> dict[str, Any]:
    """Run every job and return the whole object."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        terrain, real = TERRAIN, TERRAIN.exists()
        if not real:
            terrain = folder / "terrain.xml"
            surface_xml(136, 135, terrain)
        million = folder / "million.xml"
        surface_xml(709, 709, million)
        tracks = double_track_xml(kilometres, folder)
        return {
            "terrain": {"file": terrain.name if real else "generated", **in_process("read", [terrain])},
            "million": {"file_mb": round(million.stat().st_size / 1e6, 1), **in_process("read", [million])},
            "double_track": {"km": kilometres, **in_process("limits", tracks)},
        }


def main() -> None:
    """Run the benchmark, or one job of it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", action="store_true", help="print one JSON object and nothing else")
    parser.add_argument("--km", type=float, default=KILOMETRES, help="length of the double track")
    parser.add_argument("--job", choices=("read", "limits"), help=argparse.SUPPRESS)
    parser.add_argument("files", nargs="*", type=Path, help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.job is not None:
        print(json.dumps((read_job if given.job == "read" else limits_job)(given.files)))
        return
    result = run(given.km)
    if given.json:
        print(json.dumps(result))
        return
    for job, numbers in result.items():
        print(job)
        for key, value in numbers.items():
            print(f"  {key:12} {value}")


if __name__ == "__main__":
    main()
