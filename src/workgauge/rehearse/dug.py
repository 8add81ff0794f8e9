"""What a run has dug: the true edge, tick by tick, against the surface its steps were to grade."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from workgauge.motion.bucket.dug import DugMap, dug_map
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

    Of several steps with different buckets or surfaces the first one's count.
    """
    chosen = [(k, step) for k, step in enumerate(steps) if isinstance(step, GradeSurface)]
    if auto is None or not chosen:
        return None
    step = chosen[0][1]
    numbers = {k for k, _ in chosen}
    cuts = [
        _poses(session, series.q[auto.which == number])
        for number, job in enumerate(auto.jobs)
        if job.step in numbers and job.job.startswith("cut ")
    ]
    cuts = [cut for cut in cuts if len(cut) > 1]
    if not cuts:
        return None
    tin = Grading(session.site, session.frame.origin).tin(step.surface)
    return dug_map(tin, cuts, step.bucket_width_m, session.frame.origin, allowed_m=step.over_dig_mm * 1e-3)


def _poses(session: "Session", q: Floats) -> Floats:
    """Return the tool's poses (N, 4, 4) in the site's local frame at joints (N, n)."""
    T = session.true_state[1]
    machine = session.machine
    poses = [machine.tool_pose(machine.forward(one)) for one in q]
    return np.asarray(T @ np.array(poses)) if poses else np.zeros((0, 4, 4))
