"""What the tick is told once and for all."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

from workgauge.drive.api import Drive
from workgauge.drive.ideal import IdealDrive
from workgauge.gate.gate import GateConfig
from workgauge.guard.api import Guard
from workgauge.machine.model import MachineModel
from workgauge.machine.positioning import IntegritySpec
from workgauge.motion.desired import MotionConfig
from workgauge.motion.joystick import LeverFeel
from workgauge.proximity.protection import Integrity
from workgauge.values.commands import VALVE_FULL, ValveCommand
from workgauge.values.errors import InputError, WireError
from workgauge.values.limits import Limit
from workgauge.values.measurements import Stamp
from workgauge.wire.messages import encode

#: Name of the tick in the frames it makes.
SOURCE = "tick"
#: The gate tolerates inputs this many times as old as the tick does before it shuts.
GATE_PATIENCE = 2.0


@dataclass(frozen=True, slots=True, eq=False)
class TickConfig:
    """Everything the tick needs that does not change from tick to tick.

    Attributes:
        machine: kinematics and speeds. machine_id: whose inputs count and whose valves are commanded.
        guard: one of `guard.registry`.
        radius_m: clearances are searched this far [m].
        integrity: how sure a clearance's lower bound must be.
        tool_sigma_m: 1-sigma of where the attachment sits on its link [m].
        dt_s: the tick's period [s].
        posture_age_s, pose_age_s, intent_age_s: oldest inputs to move on [s].
        motion: levers and inverse kinematics.
        drive: velocity to valves. max_step: (n) largest valve opening per tick, beyond what the drive jumps.
        gate: the gate's own limits.
        ranges: whether the guard is to say what each lever may still do.
    """

    machine: MachineModel
    machine_id: str
    guard: Guard
    radius_m: float
    integrity: Integrity
    tool_sigma_m: float
    dt_s: float
    posture_age_s: float
    pose_age_s: float
    intent_age_s: float
    motion: MotionConfig
    drive: Drive
    max_step: tuple[int, ...]
    gate: GateConfig
    ranges: bool = True


def tick_config(
    machine: MachineModel,
    guard: Guard,
    *,
    machine_id: str,
    dt_s: float = 0.02,
    radius_m: float = 8.0,
    posture_age_s: float = 0.1,
    pose_age_s: float = 0.2,
    intent_age_s: float = 0.2,
    ramp_s: float = 0.2,
    motion: MotionConfig | None = None,
    integrity: Integrity | None = None,
    tool_sigma_m: float | None = None,
    drive: Drive | None = None,
) -> TickConfig:
    """Return a configuration whose parts agree with each other.

    Args:
        machine, guard: see `TickConfig`.
        machine_id: 1 to 32 bytes.
        dt_s: the tick's period [s].
        radius_m: search radius, at least the guard's reach; see `search_radius_m` [m].
        posture_age_s, pose_age_s, intent_age_s: oldest inputs to move on [s].
        ramp_s: time from closed to full valve, at least one period [s].
        motion: the levers' and paths' settings; its period is overridden, and its ramp unless one is given.
        integrity: left out, the machine file's, whose default is a risk of 1e-7 without bias.
        tool_sigma_m: left out, the mounted attachment's tolerance; 0 for one known exactly [m].
        drive: left out, the ideal one.

    Raises:
        InputError: for a value that makes no sense, naming it.
    """
    _check("dt_s", dt_s, 1e-4 <= dt_s <= 1.0, "0.0001 to 1 s")
    _check("radius_m", radius_m, guard.reach_m <= radius_m < 1e4, f"at least the guard's reach, {guard.reach_m} m")
    _check("ramp_s", ramp_s, 0.0 <= ramp_s <= 10.0, "0 to 10 s")
    if integrity is None:
        integrity = Integrity.of(machine.positioning.integrity if machine.positioning else IntegritySpec())
    _check("integrity.k", integrity.k, 0.0 < integrity.k < 1e3, "above 0, less than 1000")
    _check("integrity.bias_m", integrity.bias_m, 0.0 <= integrity.bias_m < 1e3, "0 to 1000 m")
    if tool_sigma_m is None:
        tool_sigma_m = machine.tool_tolerance_m
    _check("tool_sigma_m", tool_sigma_m, 0.0 <= tool_sigma_m < 1e3, "0 to 1000 m")
    ages = {"posture_age_s": posture_age_s, "pose_age_s": pose_age_s, "intent_age_s": intent_age_s}
    for name, age in ages.items():
        _check(name, age, 0.0 < age <= 10.0, "above 0, at most 10 s")
    try:
        encode(ValveCommand(Stamp(machine_id, 0, SOURCE), 0, (0,) * machine.n, False))
    except WireError as error:
        raise InputError(error.message, element="machine_id", value=machine_id, allowed=error.allowed) from None
    given = motion or MotionConfig(feel=LeverFeel(ramp_s=ramp_s))
    settings = {name: getattr(given, name) for name in MotionConfig.__slots__} | {"dt_s": dt_s}
    settings["follow"] = replace(given.follow, bend=given.follow.bend and not guard.steers_itself)
    drive = drive or IdealDrive.of(machine)
    step = max(int(VALVE_FULL * dt_s / ramp_s), 1) if ramp_s > dt_s else VALVE_FULL
    jumping = tuple(min(step + max(jump), VALVE_FULL) for jump in drive.jump)
    return TickConfig(
        machine=machine,
        machine_id=machine_id,
        guard=guard,
        radius_m=radius_m,
        integrity=integrity,
        tool_sigma_m=tool_sigma_m,
        dt_s=dt_s,
        posture_age_s=posture_age_s,
        pose_age_s=pose_age_s,
        intent_age_s=intent_age_s,
        motion=MotionConfig(**settings),
        drive=drive,
        max_step=(step,) * machine.n,
        gate=_gate_config(machine, machine_id, jumping, dt_s, ages),
    )


def _gate_config(
    machine: MachineModel, machine_id: str, steps: tuple[int, ...], dt_s: float, ages_s: Mapping[str, float]
) -> GateConfig:
    """Return a gate as strict as the tick, and as patient as it must be to let the tick speak first."""
    oldest_ns = {name: round(GATE_PATIENCE * age * 1e9) for name, age in ages_s.items()}
    return GateConfig(
        machine_id=machine_id,
        source="gate",
        joints=machine.n,
        valve_limit=VALVE_FULL,
        max_step=steps,
        posture_age_ns=oldest_ns["posture_age_s"],
        pose_age_ns=oldest_ns["pose_age_s"],
        intent_age_ns=oldest_ns["intent_age_s"],
        command_age_ns=round(dt_s * 1e9),
        exclusive_groups=machine.exclusive_groups,
    )


def search_radius_m(guard: Guard, limits: Iterable[Limit], protection_m: float = 3.0) -> float:
    """Return the radius within which the guard must know every one of these limits [m].

    Its own reach, what the largest stop distance of a limit's own adds to it, and the largest protection level to be
    worked with. With a larger one the tick stops: a limit out of sight could be one that matters.
    """
    own = max((limit.stop_distance_m or 0.0 for limit in limits), default=0.0)
    return guard.reach_m + max(own, 0.0) + protection_m


def _check(name: str, value: float, fine: bool, allowed: str) -> None:
    if not fine:
        raise InputError("setting out of range", element=name, value=value, allowed=allowed)
