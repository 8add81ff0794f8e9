"""The potential guard as guards to compare with: as the document prints it, and as the program has it."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

from workgauge.guard.api import Guard
from workgauge.guard.potential import Points, PotentialGuard


@dataclass(frozen=True, slots=True)
class PotentialField(PotentialGuard):
    """Mäkinen's field, one closest point per link and no more than the field, unless told otherwise.

    Its name in the tables: `potential`, with `-each-limit` for one point per link and limit, which the document names
    as what can already be done, and `-held` where the approach ends at the stop distance.
    """

    points: Points = Points.PER_LINK
    hold: bool = False

    @property
    def name(self) -> str:
        """Name in the tables."""
        return f"potential{'-each-limit' if self.points is Points.PER_LIMIT else ''}{'-held' if self.hold else ''}"


#: Name to baseline; the last is the program's own guard.
BASELINES: dict[str, Callable[..., Guard]] = {
    "potential": PotentialField,
    "potential-each-limit": partial(PotentialField, points=Points.PER_LIMIT),
    "potential-each-limit-held": partial(PotentialField, points=Points.PER_LIMIT, hold=True),
}
