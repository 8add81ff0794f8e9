"""The tick: inputs, memory and configuration in; command bytes, memory and trace out; nothing else."""

import math
from dataclasses import dataclass, replace

import numpy as np

from workgauge.drive.ramp import ramped
from workgauge.gate.gate import GateFacts, GateState, vet
from workgauge.guard.api import GuardInput, Memory
from workgauge.guard.exit import Exit
from workgauge.loop.asked import asked_for
from workgauge.loop.config import SOURCE, TickConfig
from workgauge.loop.inputs import TickInputs, believed
from workgauge.loop.memory import TickMemory
from workgauge.machine.model import Kinematics
from workgauge.motion.desired import MotionMemory, exit_share, tool_rates
from workgauge.motion.follow import released
from workgauge.motion.job import JobFacts, JobMemory
from workgauge.proximity.protection import with_protection
from workgauge.proximity.surroundings import Surroundings
from workgauge.proximity.uncertainty import MachineUncertainty
from workgauge.values.arrays import Floats, freeze
from workgauge.values.clearances import Clearances
from workgauge.values.commands import ValveCommand
from workgauge.values.measurements import MachinePose, Posture, Stamp
from workgauge.values.ranges import LeverRanges
from workgauge.values.reasons import Reason, ReasonCode
from workgauge.wire.messages import SEQUENCE_MODULUS, encode


@dataclass(frozen=True, slots=True)
class TickOutputs:
    """What leaves the tick: one valve command frame, neutral if anything is wrong."""

    frame: bytes


@dataclass(frozen=True, slots=True, eq=False)
class Trace:
    """What the tick saw and did.

    Attributes:
        now_ns: the tick's clock [ns].
        q: (n,) measured joint positions, None without a posture to be believed.
        desired, allowed: (n,) joint velocities the operator wanted and the guard left [rad/s, m/s].
        valves: (n) as sent.
        clearances: with their protection levels; None without posture and machine pose.
        reasons: every intervention of this tick.
        scale: what the clearances left of the velocity.
        ranges: what each lever may still do; None if the guard was not asked or cannot say.
        exit: the way out of limits the machine is inside of, or what leaves none; None if it was not sought.
        job: how far automatic motion is; None if nobody asked for any.
    """

    now_ns: int
    q: Floats | None
    desired: Floats
    allowed: Floats
    valves: tuple[int, ...]
    clearances: Clearances | None
    reasons: tuple[Reason, ...]
    scale: float
    ranges: LeverRanges | None = None
    exit: Exit | None = None
    job: JobFacts | None = None


def tick(inputs: TickInputs, memory: TickMemory, config: TickConfig) -> tuple[TickOutputs, TickMemory, Trace]:
    """Return the command for this period, the memory for the next, and what was seen and done.

    Freshness, kinematics, proximity, protection levels, motion, guard, drive, ramp, gate, in this order. Pure: the
    same arguments give the same bytes. An input that is missing, old, from the future, of another machine or not made
    of numbers stops every joint with the reason, and so does a position not to be used, or so uncertain that a limit
    out of sight may matter; no measurement makes it raise.
    """
    now, machine = inputs.now_ns, config.machine
    seen = believed(inputs, config)
    reasons = list(seen.reasons)
    wanted = allowed = _still(machine.n)
    scale, motion_memory, clearances = 0.0, MotionMemory(), None
    ranges: LeverRanges | None = None
    way_out: Exit | None = None
    at = seen.posture.q.tolist() if seen.posture is not None else None
    sent = np.array(config.drive.velocity(memory.valves, at))
    elapsed_s = config.dt_s if memory.at_ns is None else max((now - memory.at_ns) * 1e-9, 0.0)
    guard_memory: Memory | None = None
    job_memory: JobMemory | None = None
    job_facts: JobFacts | None = None

    if seen.posture is not None and seen.pose is not None:
        kin = machine.forward(seen.posture.q)
        clearances, rows, around, unsure = _clearances(inputs, kin, seen.posture, seen.pose, config)
        if unsure is not None:
            reasons.append(unsure)
        elif seen.intent is not None and seen.intent.enable:
            asked = asked_for(
                *(inputs.job, seen.intent, kin, seen.pose.T_site_machine, clearances, rows),
                *(memory.motion, memory.job, config),
                sent=sent,
            )
            wanted, motion_memory, job_facts = asked.velocity, asked.motion, asked.facts
            given = GuardInput(
                desired=wanted,
                q=kin.q,
                q_min=machine.q_min,
                q_max=machine.q_max,
                speed_positive=machine.speed_positive,
                speed_negative=machine.speed_negative,
                clearances=clearances,
                rows=rows,
                dt_s=config.dt_s,
                joint_names=machine.joint_names,
                exclusive_groups=machine.exclusive_groups,
                keep_direction=asked.keep_direction,
                sent=sent,
                elapsed_s=elapsed_s,
                age_s=seen.posture.stamp.age_s(now),
                around=around,
                tool_rates=tool_rates(machine, kin, config.motion) if config.ranges else None,
                exit_share=exit_share(seen.intent, motion_memory),
                task=asked.task,
            )
            result, guard_memory = config.guard.allow(given, memory.guard)
            allowed, scale, ranges, way_out = result.allowed, result.scale, result.ranges, result.exit
            reasons += (*asked.reasons, *result.reasons)
            job_memory = replace(asked.job, allowed=scale)
    if guard_memory is None:
        guard_memory = config.guard.idle(sent, machine, config.dt_s, elapsed_s, memory.guard)
    if job_memory is None:
        job_memory = released(memory.job)

    valves = ramped(
        memory.valves, config.drive.valves(allowed.tolist(), at, memory.valves), config.max_step, config.drive.jump
    )
    frame, gate, refusals = _vetted(valves, inputs, memory, config)
    said = {reason.code for reason in seen.reasons}
    reasons += [reason for reason in refusals if reason.code not in said]
    sequence = (memory.sequence + 1) % SEQUENCE_MODULUS
    after = TickMemory(sequence, gate.valves, motion_memory, guard_memory, gate, now, job_memory)
    q = seen.posture.q if seen.posture is not None else None
    trace = Trace(
        *(now, q, wanted, allowed, gate.valves, clearances, tuple(reasons), scale, ranges, way_out, job_facts)
    )
    return TickOutputs(frame), after, trace


def _clearances(
    inputs: TickInputs, kin: Kinematics, posture: Posture, pose: MachinePose, config: TickConfig
) -> tuple[Clearances, Floats, Surroundings, Reason | None]:
    """Return the clearances with protection levels, their rows, what stands around, and why that is too little."""
    machine, scene, T_site_machine = config.machine, inputs.scene, pose.T_site_machine
    found = scene.query(kin, T_site_machine, config.radius_m, inputs.now_ns, inputs.off_states, inputs.let_off)
    rows = machine.distance_rows(kin, T_site_machine, found)
    uncertainty = MachineUncertainty.of(
        pose.covariance,
        posture.sigma,
        tool_sigma_m=config.tool_sigma_m,
        cross=pose.cross,
        joint_covariance=posture.covariance,
    )
    clearances, largest = with_protection(
        found, rows, kin, machine, T_site_machine, uncertainty, scene.uncertainty, config.integrity
    )
    around = Surroundings(
        *(scene, T_site_machine, uncertainty, config.integrity, largest),
        *(inputs.now_ns, inputs.off_states, inputs.let_off),
    )
    covered = config.radius_m - config.guard.reach_m - scene.largest_stop_m
    if largest <= covered:
        return clearances, rows, around, None
    how = f"up to {largest:.2f} m" if math.isfinite(largest) else "by more than can be said"
    text = f"clearances may be wrong {how}, limits are known for {max(covered, 0.0):.2f} m"
    return clearances, rows, around, Reason(ReasonCode.POSITION_UNSURE, text, protection_m=largest, scale=0.0)


def _vetted(
    valves: tuple[int, ...], inputs: TickInputs, memory: TickMemory, config: TickConfig
) -> tuple[bytes, GateState, tuple[Reason, ...]]:
    """Return the gate's verdict on the frame of these valves. The gate is handed the inputs as they came."""
    intent = inputs.intent
    enable = intent is not None and intent.enable
    facts = GateFacts(
        now_ns=inputs.now_ns,
        posture=inputs.posture.stamp if inputs.posture is not None else None,
        pose=inputs.pose.stamp if inputs.pose is not None else None,
        intent=intent.stamp if intent is not None else None,
        enable=enable,
        levers_neutral=intent is not None
        and all(abs(lever) <= config.motion.feel.dead_zone for lever in intent.levers.values),
    )
    command = ValveCommand(Stamp(config.machine_id, inputs.now_ns, SOURCE), memory.sequence, valves, enable)
    return vet(encode(command), facts, memory.gate, config.gate)


def _still(n: int) -> Floats:
    velocity = np.zeros(n)
    freeze(velocity)
    return velocity
