"""The tick: inputs, memory and configuration in; command bytes, memory and trace out; nothing else."""

from dataclasses import dataclass

import numpy as np

from workgauge.drive.ramp import ramped
from workgauge.gate.gate import GateFacts, GateState, vet
from workgauge.guard.api import GuardInput
from workgauge.loop.config import SOURCE, TickConfig
from workgauge.loop.inputs import TickInputs, believed
from workgauge.loop.memory import TickMemory
from workgauge.machine.model import Kinematics
from workgauge.motion.desired import MotionMemory, desired
from workgauge.values.arrays import Floats, freeze
from workgauge.values.clearances import Clearances
from workgauge.values.commands import ValveCommand
from workgauge.values.measurements import DriveMode, Stamp
from workgauge.values.reasons import Reason
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
        clearances: None without posture and machine pose.
        reasons: every intervention of this tick.
        scale: what the clearances left of the velocity.
    """

    now_ns: int
    q: Floats | None
    desired: Floats
    allowed: Floats
    valves: tuple[int, ...]
    clearances: Clearances | None
    reasons: tuple[Reason, ...]
    scale: float


def tick(inputs: TickInputs, memory: TickMemory, config: TickConfig) -> tuple[TickOutputs, TickMemory, Trace]:
    """Return the command for this period, the memory for the next, and what was seen and done.

    Freshness, kinematics, proximity, motion, guard, drive, gate, in this order. Pure: the same arguments give the
    same bytes. An input that is missing, old, from the future, of another machine or not made of numbers stops every
    joint with the reason; no measurement makes it raise.
    """
    now, machine = inputs.now_ns, config.machine
    seen = believed(inputs, config)
    reasons = list(seen.reasons)
    wanted = allowed = _still(machine.n)
    scale, motion_memory, guard_memory = 0.0, MotionMemory(), config.guard.start()

    clearances = None
    if seen.q is not None and seen.T_site_machine is not None:
        kin = machine.forward(seen.q)
        clearances = inputs.scene.query(
            kin, seen.T_site_machine, config.radius_m, now, inputs.off_states, inputs.let_off
        )
        if seen.intent is not None and seen.intent.enable:
            wanted, hindered, motion_memory = desired(
                seen.intent, kin, machine, seen.T_site_machine, memory.motion, config.motion
            )
            rows = machine.distance_rows(kin, seen.T_site_machine, clearances)
            given = _guard_input(wanted, kin, clearances, rows, seen.intent.mode, config)
            result, guard_memory = config.guard.allow(given, memory.guard)
            allowed, scale = result.allowed, result.scale
            reasons += (*hindered, *result.reasons)

    valves = ramped(memory.valves, config.drive.valves(allowed.tolist()), config.max_step)
    frame, gate, refusals = _vetted(valves, inputs, memory, config)
    said = {reason.code for reason in seen.reasons}
    reasons += [reason for reason in refusals if reason.code not in said]
    sequence = (memory.sequence + 1) % SEQUENCE_MODULUS
    after = TickMemory(sequence, gate.valves, motion_memory, guard_memory, gate)
    trace = Trace(now, seen.q, wanted, allowed, gate.valves, clearances, tuple(reasons), scale)
    return TickOutputs(frame), after, trace


def _guard_input(
    wanted: Floats, kin: Kinematics, clearances: Clearances, rows: Floats, mode: DriveMode, config: TickConfig
) -> GuardInput:
    machine = config.machine
    return GuardInput(
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
        keep_direction=mode is not DriveMode.JOINT,
    )


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
