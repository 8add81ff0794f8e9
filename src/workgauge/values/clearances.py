"""Signed distances between link solids and limits, as arrays for the tick and one by one for people."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from workgauge.values.arrays import Floats, Ints


@dataclass(frozen=True, slots=True, eq=False)
class Clearance:
    """One clearance, equations 2.1 and 2.2 of Mäkinen.

    Attributes:
        distance_m: signed, negative inside.
        normal: (3,) unit vector in the site frame, from the limit to the machine: the way out.
        point_machine, point_limit: (3,) closest points in the site frame [m].
        link: link name. limit: limit id, or `self:<link>` for the machine's own link.
        cell: index of the chain's cell or triangle, -1 if there is none.
        protection_m: protection level, the part of the distance that is not sure.
        stop_distance_m: smallest clearance allowed by this limit's own rule, NaN for the guard's own.
    """

    distance_m: float
    normal: Floats
    point_machine: Floats
    point_limit: Floats
    link: str
    limit: str
    cell: int
    protection_m: float
    stop_distance_m: float


@dataclass(frozen=True, slots=True, eq=False)
class Clearances:
    """k clearances as arrays, in a stable order (by link solid, then limit, then cell).

    Attributes:
        distances: (k,) signed [m]. normals: (k, 3). points_machine: (k, 3). points_limit: (k, 3). Site frame.
        links: (k,) index of the link. other_links: (k,) index of the other link, -1 for the environment.
        limits: (k,) index into `limit_ids`. cells: (k,).
        solids: (k,) index of the machine's solid that lies on the link.
        protections: (k,) [m]. stop_distances: (k,) [m], NaN for the guard's own.
        link_names, limit_ids: what the indices mean.
        searched_m: every pair nearer than this is in here; nothing is said of pairs farther away.
    """

    distances: Floats
    normals: Floats
    points_machine: Floats
    points_limit: Floats
    links: Ints
    other_links: Ints
    limits: Ints
    cells: Ints
    solids: Ints
    protections: Floats
    stop_distances: Floats
    link_names: tuple[str, ...]
    limit_ids: tuple[str, ...]
    searched_m: float

    def __len__(self) -> int:
        return len(self.distances)

    def __getitem__(self, i: int) -> Clearance:
        return Clearance(
            float(self.distances[i]),
            self.normals[i],
            self.points_machine[i],
            self.points_limit[i],
            self.link_names[self.links[i]],
            self.limit_ids[self.limits[i]],
            int(self.cells[i]),
            float(self.protections[i]),
            float(self.stop_distances[i]),
        )

    def __iter__(self) -> Iterator[Clearance]:
        return (self[i] for i in range(len(self)))

    def with_protections(self, protections: Floats) -> "Clearances":
        """Return the same clearances with these protection levels (k,) [m], read-only."""
        return Clearances(
            *(self.distances, self.normals, self.points_machine, self.points_limit),
            *(self.links, self.other_links, self.limits, self.cells, self.solids),
            *(protections, self.stop_distances),
            self.link_names,
            self.limit_ids,
            self.searched_m,
        )

    def nearest(self) -> Clearance | None:
        """Return the smallest clearance, or None if nothing lies within `searched_m`."""
        return self[int(np.argmin(self.distances))] if len(self) else None
