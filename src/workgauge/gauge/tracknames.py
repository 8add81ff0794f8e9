"""What the alignments of a site are called when they are told apart, also where two have the same name."""

from collections import Counter

from workgauge.site.alignment import Alignment
from workgauge.site.model import SiteModel


def track_names(site: SiteModel) -> list[tuple[Alignment, str]]:
    """Return every alignment with a name of its own: the second `A` is `A#2`, unless another is called so."""
    taken = Counter(alignment.name for alignment in site.alignments)
    seen: Counter[str] = Counter()
    out = []
    for alignment in site.alignments:
        seen[alignment.name] += 1
        name, number = alignment.name, seen[alignment.name]
        while number > 1 and taken[name := f"{alignment.name}#{number}"]:
            number += 1
        if number > 1:
            taken[name] += 1
        out.append((alignment, name))
    return out
