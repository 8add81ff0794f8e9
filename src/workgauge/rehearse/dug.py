"""What a run has dug: the true edge, tick by tick, against the surface its steps were to grade."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from workgauge.motion.bucket.dug import DugMap, dug_map, merged
from workgauge.rehearse.auto_series import AutoSeries
from workgauge.rehearse.auto_steps import GradeSurface
from workgauge.rehearse.grading import Grading
from workgauge.rehearse.result import Series
from workgauge.rehearse.scenario import Step
from workgauge.values.arrays import Floats

if TYPE_CHECKING:
    from workgauge.rehearse.session import Session


def dug_in(session: "Session", steps: Sequence[Step], series: Series, auto: AutoSeries | None) -> DugMap | None:
    """Return what the cuts of a run's grading steps left of the design, None where there were none.

    Every step counts against its own design, with its own bucket. The edge's depth counts on its ways there and back
    as well: it may go too deep as it is let down.
    """
    if auto is None:
        return None
    grading, origin = Grading(session.site, session.frame.origin), session.frame.origin
    found: list[DugMap] = []
    for k, step in enumerate(steps):
        if not isinstance(step, GradeSurface):
            continue
        driven: dict[bool, list[Floats]] = {True: [], False: []}
        for number, job in enumerate(auto.jobs):
            if job.step == k:
                driven[job.job.startswith("cut ")].append(_poses(session, series.q[auto.which == number]))
        cuts = [cut for cut in driven[True] if len(cut) > 1]
        allowed, beside = step.over_dig_mm * 1e-3, [way for way in driven[False] if len(way)]
        dug = dug_map(grading.tin(step.surface), cuts, step.bucket_width_m, origin, allowed_m=allowed, beside=beside)
        if dug is not None:
            found.append(dug)
    return merged(found) if found else None


def _poses(session: "Session", q: Floats) -> Floats:
    """Return the tool's poses (N, 4, 4) in the site's local frame at joints (N, n)."""
    T = session.true_state[1]
    machine = session.machine
    poses = [machine.tool_pose(machine.forward(one)) for one in q]
    return np.asarray(T @ np.array(poses)) if poses else np.zeros((0, 4, 4))
