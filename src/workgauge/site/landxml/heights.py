"""Heights nobody built or surveyed: no-data numbers and strays, told and kept."""

from collections.abc import Callable

import numpy as np

from workgauge.site.landxml.document import Document
from workgauge.site.landxml.units import FileUnits
from workgauge.values.arrays import Floats

#: Heights may lie this far from the median of their kind without a warning [m].
HEIGHT_SPREAD_M = 1000.0
#: What programs write where they have no height, in the file's unit.
NO_DATA = (-999.0, -9999.0, -99999.0, -999999.0, -32767.0, -32768.0, 9999.0, 99999.0, 999999.0)


def doubt_heights(
    document: Document,
    units: FileUnits,
    heights: Floats,
    owner: str,
    line: int | None = None,
    name: Callable[[int], str] | None = None,
) -> None:
    """Warn of heights (n,) [m] that are no-data numbers or stand far from the median of the others; NaN is no height.

    Args:
        owner: whose heights, for the warning. line: its line. name: who has height i, if they have names.
    """
    no_data = np.isclose(heights[:, None] / units.elevation, NO_DATA, rtol=0.0, atol=1e-6).any(axis=1)
    others = heights[np.isfinite(heights) & ~no_data]
    middle = float(np.median(others)) if len(others) else None
    with np.errstate(invalid="ignore"):
        stray = np.zeros(len(heights), dtype=bool) if middle is None else np.abs(heights - middle) > HEIGHT_SPREAD_M
    doubtful = np.flatnonzero(no_data | stray)
    if not len(doubtful):
        return
    first = int(doubtful[0])
    unit = units.names["elevation"]
    who = "" if name is None else f" ({name(first)})"
    than = "" if middle is None else f" or more than {HEIGHT_SPREAD_M:g} m from the median {middle:.2f} m"
    document.warn(
        f"{len(doubtful)} of {int(np.isfinite(heights).sum())} heights are implausible, the first "
        f"{heights[first] / units.elevation:.9g} {unit}{who}: a no-data number{than}; kept",
        owner,
        line,
    )
