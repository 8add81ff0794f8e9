"""Edges brought into a triangulation by flipping diagonals (Sloan 1993)."""

from collections import deque

import numpy as np

from workgauge.values.arrays import Floats, Ints
from workgauge.values.errors import SiteError

_FLAT = 1e-12


class Mesh:
    """Triangles by their directed edges: `across[a, b]` is the corner left of the edge from a to b.

    Args:
        plan: (n, 2). faces: (m, 3) counter-clockwise.
    """

    def __init__(self, plan: Floats, faces: Ints) -> None:
        self._plan: list[tuple[float, float]] = [(x, y) for x, y in plan.tolist()]
        self._across: dict[tuple[int, int], int] = {}
        self._beside: dict[int, set[int]] = {}
        for a, b, c in faces.tolist():
            for i, j, k in ((a, b, c), (b, c, a), (c, a, b)):
                self._across[i, j] = k
                self._beside.setdefault(i, set()).update((j, k))

    def with_edges(self, wanted: set[tuple[int, int]]) -> Ints:
        """Return faces (m, 3) that have all wanted edges; the others are Delaunay's as far as those allow.

        Raises:
            SiteError: an edge cannot be brought in.
        """
        changed: set[tuple[int, int]] = set()
        for a, b in sorted(wanted):
            changed |= self._bring(a, b)
        self._mended(changed, wanted)
        return self._faces()

    def _bring(self, a: int, b: int) -> set[tuple[int, int]]:
        """Flip the edges in the way of an edge, and return those that came instead."""
        if (a, b) in self._across or (b, a) in self._across:
            return set()
        ways = deque(self._crossed(a, b))
        new: set[tuple[int, int]] = set()
        tries = 20 * len(ways) ** 2 + 100
        while ways:
            tries -= 1
            if tries < 0:
                place = f"between ({self._plan[a]}) and ({self._plan[b]})"
                raise SiteError("a break line cannot be brought in", element="breakline", value=place)
            i, j = ways.popleft()
            k, m = self._across[i, j], self._across[j, i]
            if not (self._turn(m, j, k) > _FLAT and self._turn(k, i, m) > _FLAT):
                ways.append((i, j))  # the four corners are not convex yet
                continue
            self._flip(i, j)
            if self._cross(k, m, a, b):
                ways.append((k, m))
            else:
                new.add((min(k, m), max(k, m)))
        return new

    def _crossed(self, a: int, b: int) -> list[tuple[int, int]]:
        """Return the edges that the straight line from a to b crosses, in order."""
        found: list[tuple[int, int]] = []
        for j in sorted(self._beside[a]):
            k = self._across.get((a, j))
            if k is not None and self._turn(a, b, j) < 0.0 < self._turn(a, b, k):
                i, j = j, k
                break
        else:
            place = f"at ({self._plan[a]})"
            raise SiteError("a break line cannot be brought in", element="breakline", value=place)
        while True:
            found.append((i, j))
            m = self._across[j, i]
            if m == b:
                return found
            i, j = (i, m) if self._turn(a, b, m) > 0.0 else (m, j)

    def _mended(self, edges: set[tuple[int, int]], kept: set[tuple[int, int]]) -> None:
        """Flip edges that are not Delaunay's (Lawson), kept ones aside."""
        ways = deque(sorted(edges))
        most = 50 * len(ways) + 1000
        while ways and most:
            most -= 1
            i, j = ways.popleft()
            if (min(i, j), max(i, j)) in kept or (i, j) not in self._across or (j, i) not in self._across:
                continue
            k, m = self._across[i, j], self._across[j, i]
            if self._turn(m, j, k) > _FLAT and self._turn(k, i, m) > _FLAT and self._in_circle(i, j, k, m) > 1e-9:
                self._flip(i, j)
                ways.extend(((i, m), (m, j), (j, k), (k, i)))

    def _flip(self, i: int, j: int) -> None:
        k, m = self._across.pop((i, j)), self._across.pop((j, i))
        for a, b, c in ((i, m, k), (m, j, k)):
            self._across[a, b], self._across[b, c], self._across[c, a] = c, a, b
        self._beside[i].discard(j)
        self._beside[j].discard(i)
        self._beside[k].add(m)
        self._beside[m].add(k)

    def _faces(self) -> Ints:
        rows = sorted((a, b, c) for (a, b), c in self._across.items() if a < b and a < c)
        return np.array(rows, dtype=np.int64).reshape(-1, 3)

    def _turn(self, a: int, b: int, c: int) -> float:
        """Return twice the area of a triangle, positive counter-clockwise."""
        (ax, ay), (bx, by), (cx, cy) = self._plan[a], self._plan[b], self._plan[c]
        return (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)

    def _cross(self, i: int, j: int, a: int, b: int) -> bool:
        return self._turn(a, b, i) * self._turn(a, b, j) < 0.0

    def _in_circle(self, a: int, b: int, c: int, d: int) -> float:
        """Return above 0 if d lies in the circle through a, b, c, which are counter-clockwise; in its own size."""
        (dx, dy) = self._plan[d]
        rows = [(x - dx, y - dy) for x, y in (self._plan[a], self._plan[b], self._plan[c])]
        (ax, ay), (bx, by), (cx, cy) = rows
        aa, bb, cc = (x * x + y * y for x, y in rows)
        size = max(aa, bb, cc)
        value = ax * (by * cc - bb * cy) - ay * (bx * cc - bb * cx) + aa * (bx * cy - by * cx)
        return value / (size * size) if size else 0.0
