"""Heights at plan points of a surface beside Makkonen's search by distance (4, 5): one JSON object with `--json`.

Both are given the same random points on the same triangles, in one run, one core. The search is vectorised over
all triangles for each point, as its page has it: distances from the origin between a triangle's least and greatest,
then barycentric coordinates of those left. It is given heights it would not have, and a site's own origin near by,
which is what its selection lives of. Points it rejects wrongly (nearer than all corners) are counted.

Then a grid surface of growing size, up to a million triangles.
"""

import argparse
import json
import time
from pathlib import Path

import numpy as np

from workgauge.site.read import read_site
from workgauge.site.surface.laid import laid
from workgauge.site.surface.tin import Tin
from workgauge.values.arrays import Floats

ROOT = Path(__file__).resolve().parent.parent
TERRAIN = ROOT.parent / "shared" / "data" / "landxml" / "inframodel_m3" / "M3_Terrain.mm.xml"
POINTS, SEED_POINTS = 100_000, 300


def rolling(side: int) -> Tin:
    """Return a gently rolling grid surface of 2 side^2 triangles, 2 m apart."""
    j, i = np.meshgrid(np.arange(side + 1), np.arange(side + 1))
    z = 10.0 + 2.0 * np.sin(i / 17.0) * np.cos(j / 23.0)
    vertices = np.column_stack([25_487_000.0 + 2.0 * j.ravel(), 6_650_000.0 + 2.0 * i.ravel(), z.ravel()])
    corner = ((side + 1) * np.arange(side)[:, None] + np.arange(side)).ravel()
    faces = np.concatenate(
        [
            np.column_stack([corner, corner + 1, corner + side + 2]),
            np.column_stack([corner, corner + side + 2, corner + side + 1]),
        ]
    )
    return Tin(vertices, faces, "grid")


def on_surface(tin: Tin, count: int) -> Floats:
    """Return random points (count, 2) on a surface."""
    rng = np.random.default_rng(11)
    corners = tin.vertices[tin.faces[rng.integers(0, len(tin), count)], :2]
    return np.einsum("kc,kcd->kd", rng.dirichlet(np.ones(3), count), corners)


class ByDistance:
    """Makkonen's triangle compilation and its search, vectorised over triangles."""

    def __init__(self, tin: Tin) -> None:
        corners = tin.local[tin.faces]
        distance = np.linalg.norm(corners, axis=2)
        self.least, self.most = distance.min(axis=1), distance.max(axis=1)
        self.foot, self.u, self.v = corners[:, 0], corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
        self.area = self.u[:, 0] * self.v[:, 1] - self.u[:, 1] * self.v[:, 0]

    def height(self, point: Floats) -> float:
        """Return the height at a point (3,) less the origin, NaN where none is found."""
        distance = np.sqrt(point @ point)
        near = np.flatnonzero((self.least <= distance) & (distance <= self.most))
        gap = point[:2] - self.foot[near, :2]
        u, v, area = self.u[near], self.v[near], self.area[near]
        s = (gap[:, 0] * v[:, 1] - gap[:, 1] * v[:, 0]) / area
        t = (u[:, 0] * gap[:, 1] - u[:, 1] * gap[:, 0]) / area
        on = np.flatnonzero((s >= -1e-9) & (t >= -1e-9) & (s + t <= 1.0 + 1e-9))
        if not len(on):
            return float("nan")
        k = on[0]
        return float(self.foot[near[k], 2] + s[k] * u[k, 2] + t[k] * v[k, 2])


def beside_the_seed(tin: Tin) -> dict[str, float]:
    """Return seconds per point of both, and how they agree."""
    points = on_surface(tin, POINTS)
    tin.at(points[:10])  # the index is made
    began = time.process_time()
    found = tin.at(points)
    ours = (time.process_time() - began) / POINTS
    search = ByDistance(tin)
    local = np.column_stack([points - tin.origin[:2], found.z - tin.origin[2]])[:SEED_POINTS]
    began = time.process_time()
    theirs = np.array([search.height(point) for point in local])
    seed = (time.process_time() - began) / SEED_POINTS
    missed = np.isnan(theirs)
    return {
        "triangles": len(tin),
        "points": POINTS,
        "us_per_point": round(1e6 * ours, 4),
        "by_distance_us_per_point": round(1e6 * seed, 2),
        "times_faster": round(seed / ours, 1),
        "by_distance_missed_percent": round(100.0 * float(missed.mean()), 2),
        "largest_difference_m": float(np.abs(theirs - local[:, 2])[~missed].max()),
    }


def grown(side: int) -> dict[str, float]:
    """Return what a grid of so many triangles costs: the index once, a point, a line of 20 m."""
    began = time.process_time()
    tin = rolling(side)
    made = time.process_time() - began
    points = on_surface(tin, POINTS)
    began = time.process_time()
    tin.at(points[:1])
    index = time.process_time() - began
    began = time.process_time()
    tin.at(points)
    each = (time.process_time() - began) / POINTS
    began = time.process_time()
    for point in points[:100]:
        laid(tin, [point, point + np.array([12.0, 16.0])])
    line = (time.process_time() - began) / 100
    return {
        "triangles": len(tin),
        "made_s": round(made, 3),
        "index_s": round(index, 3),
        "us_per_point": round(1e6 * each, 3),
        "line_of_20_m_ms": round(1e3 * line, 3),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    given = parser.parse_args()
    real = TERRAIN.is_file()
    tin = Tin.of_all(read_site([TERRAIN]).surfaces) if real else rolling(134)
    result = {
        "surface": TERRAIN.name if real else "generated: the real file is absent",
        "beside_by_distance": beside_the_seed(tin),
        "growth": [grown(side) for side in (71, 224, 707)],
    }
    if given.json:
        print(json.dumps(result, indent=2))
        return
    for name, value in result["beside_by_distance"].items():
        print(f"{name:28} {value}")
    for row in result["growth"]:
        print(row)


if __name__ == "__main__":
    main()
