"""Where a machine's own positioning has its tool: live in a session, or at the end of receiver logs."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from workgauge.geodesy.crs import ProjectedCrs
from workgauge.geodesy.frame import SiteFrame
from workgauge.machine.model import MachineModel
from workgauge.positioning.check import BelievedTool, tool_in_site
from workgauge.rehearse.located_log import heights_of, latencies_of, links_missing, positioning_of, replayed
from workgauge.rehearse.log_file import LogFile
from workgauge.rehearse.replay import timeline
from workgauge.values.arrays import Floats, frozen
from workgauge.values.errors import InputError
from workgauge.values.health import PositionHealth
from workgauge.values.measurements import MachinePose, Posture


def believed_tool(machine: MachineModel, frame: SiteFrame, pose: MachinePose, posture: Posture) -> BelievedTool:
    """Return where the tool is believed, in the site's absolute coordinates."""
    joints = np.diag(posture.sigma**2) if posture.covariance is None else posture.covariance
    kin = machine.forward(posture.q)
    tool = tool_in_site(machine, kin, pose.T_site_machine, pose.covariance, joints, pose.cross)
    return replace(tool, position=frozen(frame.to_absolute(tool.position)))


def tool_from_logs(
    logs: Sequence[LogFile], machine: MachineModel, crs: ProjectedCrs, near: Floats, q: Floats | None = None
) -> tuple[BelievedTool, PositionHealth, tuple[str, ...]]:
    """Return where the tool was believed last in logs, off rails; the health then; and warnings.

    Args:
        logs: of the machine's ports. near: (3,) a place by the work [m].
        q: (n,) joint positions, for logs without link sensors: the machine then stands level. None for its home.

    Raises:
        InputError: if the logs never gave a position to be used, or have no times.
    """
    section = positioning_of(machine)
    alone = links_missing(logs, section)
    if q is not None and not alone:
        raise InputError("the logs have link sensors: they say the posture", element="posture")
    standing = machine if q is None else replace(machine, home=frozen(q))
    line = timeline(logs, latencies_of(section))
    frame = SiteFrame(crs, frozen(np.round(near, -2)))
    last: tuple[BelievedTool, PositionHealth] | None = None
    reasons: tuple[str, ...] = ()
    for moment in replayed(line, standing, crs, frame, heights_of(machine), alone):
        located = moment.located
        if located.pose is not None and located.posture is not None:
            last = believed_tool(machine, frame, located.pose, located.posture), located.health
        reasons = tuple(reason.text for reason in located.health.reasons)
    if last is None:
        why = reasons[0] if reasons else "no position"
        raise InputError("the logs give no position to check", value=why, allowed="a log with fixes that agree")
    said = (
        ("no link sensors in the logs: the machine is taken to stand level, in the posture given",) if alone else ()
    )
    return *last, (*said, *line.warnings)
