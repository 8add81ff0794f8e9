"""Points at one place, joined."""

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from workgauge.values.arrays import Floats, Ints


def joined(places: Floats, within_m: float) -> tuple[Ints, Ints]:
    """Return the first of each group of places (n, k) that are one, and of each place which group it is in (n,).

    By distance, not by cells of a grid: two places a hair apart may lie in different cells. Two that
    are each joined to a third are one as well.
    """
    _, repeated, of = np.unique(places, axis=0, return_index=True, return_inverse=True)
    close = cKDTree(places[repeated]).query_pairs(within_m, output_type="ndarray")
    links = coo_array((np.ones(len(close)), (close[:, 0], close[:, 1])), shape=(len(repeated),) * 2)
    group = connected_components(links, directed=False)[1].astype(np.int64)[of.reshape(-1)]
    first: Ints = np.unique(group, return_index=True)[1]
    return first, group
