"""What is asked of the joints in this tick: by the levers, or by a job that automatic motion does."""

from dataclasses import dataclass

import numpy as np

from workgauge.loop.config import TickConfig
from workgauge.machine.model import Kinematics
from workgauge.motion.desired import MotionMemory, desired, pace
from workgauge.motion.follow import followed, released
from workgauge.motion.ik.task import orientation_of, task_jacobian
from workgauge.motion.job import Job, JobFacts, JobMemory
from workgauge.motion.slide import Surround
from workgauge.values.arrays import Floats
from workgauge.values.clearances import Clearances
from workgauge.values.measurements import DriveMode, Intent
from workgauge.values.reasons import Reason


@dataclass(frozen=True, slots=True, eq=False)
class Asked:
    """What is asked, and what is remembered of it.

    Attributes:
        velocity: (n,) joint velocities [rad/s, m/s]. reasons: what hinders it.
        motion, job: memory for the next tick. facts: how far a job is, None without one.
        keep_direction, task: see `GuardInput`.
    """

    velocity: Floats
    reasons: tuple[Reason, ...]
    motion: MotionMemory
    job: JobMemory
    facts: JobFacts | None
    keep_direction: bool
    task: Floats | None


def asked_for(
    job: Job | None,
    intent: Intent,
    kin: Kinematics,
    T_site_machine: Floats,
    clearances: Clearances,
    rows: Floats,
    motion: MotionMemory,
    memory: JobMemory,
    config: TickConfig,
    *,
    sent: Floats,
) -> Asked:
    """Return what is asked of the joints.

    Args:
        job: to be done in automatic mode. intent: of the operator.
        clearances: with protection levels, and rows (k, n) of theirs.
        motion, memory: of the last tick. sent: (n,) joint velocities that the valves ask for since then.
    """
    machine = config.machine
    velocity, reasons, motion = desired(intent, kin, machine, T_site_machine, motion, config.motion)
    if intent.mode is not DriveMode.AUTO or job is None:
        keep = intent.mode is not DriveMode.JOINT
        return Asked(velocity, reasons, motion, released(memory), None, keep, None)
    surround = surround_of(clearances, rows, T_site_machine, config)
    done = followed(
        *(job, pace(motion), kin, machine, T_site_machine, surround, memory, config.motion.follow),
        sent=sent,
        dt_s=config.dt_s,
    )
    counts = orientation_of(machine) if job.goal is None else job.goal.orientation
    task = task_jacobian(kin, machine, counts)
    return Asked(done.velocity, done.reasons, motion, done.memory, done.facts, False, task)


def surround_of(clearances: Clearances, rows: Floats, T_site_machine: Floats, config: TickConfig) -> Surround:
    """Return what automatic motion is to know of the limits: what room each clearance leaves, and where it leads."""
    own = clearances.stop_distances
    stops = np.where(np.isnan(own), getattr(config.guard, "stop_distance_m", 0.0), own)
    normals = clearances.normals @ T_site_machine[:3, :3]
    names = tuple(clearances.limit_ids[i] for i in clearances.limits.tolist())
    links = tuple(clearances.link_names[i] for i in clearances.links.tolist())
    return Surround(rows, clearances.distances - clearances.protections - stops, normals, names, links)
