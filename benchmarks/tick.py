"""How long a whole tick takes, whatever the number of limits, beside Pink and mink: one JSON object with `--json`.

Scene: the shipped 20 t road-rail excavator (6 joints, 6 boxes on 5 links), boxes of 0.4 x 0.4 x 8 m like catenary
poles on both sides, 10 m apart along the track. So the same few are near, whether there are 10 or 10,000 of them.

- `workgauge_ms`: everything between sensor values and valve bytes: freshness, kinematics, clearances within 8 m of
  every box of the machine (limits and own links), levers to joint velocities, distance rows, guard, drive, gate.
- `unsure_ms`: the same with pose and joints as sure as two RTK receivers and good joint sensors make them, so that
  each clearance gets a protection level of its own; in `workgauge_ms` they are exact.
- `barrier_ms`: the same as `workgauge_ms` with the barrier guard, and joints that follow their valves at once.
- `barrier_rollout_ms`: the barrier guard with 0.3 s of dead time, 0.2 s of lag and 0.6 s from full speed to rest,
  each known to 20 %: every tick rolls all commands in flight out to rest, and once more what it chooses. Where such
  joints are depends on what was commanded before: the ticks of a simulated drive, to and fro between the poles by a
  lever that changes sides every 2.5 s, are recorded and then timed.
- `pink_ms`: `Configuration.update` with the same boxes and pairs as a pinocchio collision model, then `solve_ik`: a
  posture task for the same joint velocity, joint and speed limits, and `SelfCollisionBarrier`, its barrier for pairs
  of bodies, told to keep only the 16 nearest. No freshness, no drive, no gate.
- `mink_ms`: `Configuration.update`, then `solve_ik`: the same task and limits, and `CollisionAvoidanceLimit` on the
  same boxes with its broad phase on, searching the same 8 m. By its own rule it leaves out pairs of a limit with the
  undercarriage, which does not move. No freshness, no drive, no gate.
- `pink_over_barrier`, `mink_over_barrier`: how many times `barrier_ms` they take.
- `terrain_ms`: the workgauge tick with 10 limits and a terrain of 100,352 triangles as a one-sided surface for all
  links but the undercarriage.

All run over the same postures, a swing to and fro past the poles, in this process, and solve with daqp. Medians; Pink
runs fewer times where it takes long. A peer that is not installed is null. So is Pink at 10,000: pinocchio copies a
table of all pairs of bodies for each body added, half a minute for 4,000 and growing with the cube.
"""

import argparse
import importlib.util
import json
import statistics
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from workgauge.guard.registry import guard_named
from workgauge.loop.config import TickConfig, tick_config
from workgauge.loop.inputs import TickInputs
from workgauge.loop.memory import first_memory
from workgauge.loop.tick import tick
from workgauge.loop.warm import warm_up
from workgauge.machine.load import load_machine
from workgauge.machine.model import MachineModel
from workgauge.machine.parts import Stopping
from workgauge.proximity.scene import Scene
from workgauge.sim.hydraulics import HydraulicSpec
from workgauge.sim.joints import HydraulicJoints
from workgauge.values.arrays import Floats, frozen
from workgauge.values.limits import Limit, LimitKind, Source
from workgauge.values.measurements import DriveMode, Intent, Levers, MachinePose, Posture, Stamp
from workgauge.values.solids import Box, Surface
from workgauge.values.transforms import translation

ROWS = (10, 100, 1_000, 10_000)
SPACING_M, SIDE_M = 10.0, 3.5
POLE = (0.2, 0.2, 4.0)
NEAREST_PAIRS = 16
PINK_MOST_LIMITS = 4_000
SEARCH_M = 8.0
STOP_M = 0.2
GROUND_M = -0.6
ID = "benchmark"
DT_S = 0.02
POSTURES = 100
#: Dead time, lag, from full speed to rest [s]; relative tolerance.
ROLLED_OUT = 0.3, 0.2, 0.6, 0.2
#: How long a drive of late joints is recorded, and how long a lever stays on one side [s].
DRIVE_S, SIDE_S = 20.0, 2.5
POSITION_SIGMA_M, TURN_SIGMA, JOINT_SIGMA = (0.015, 0.015, 0.025), (0.001, 0.001, 0.0026), 0.0018


@dataclass(frozen=True)
class Job:
    """What every contestant is given: the machine, postures along a motion, and the joint velocity wanted at each."""

    machine: MachineModel
    postures: Floats
    wanted: Floats


def job() -> Job:
    """A swing by 0.3 rad to and fro around the home posture, the boom lifting a little."""
    machine = load_machine("rre20")
    phase = np.linspace(0.0, 2.0 * np.pi, POSTURES, endpoint=False)
    postures = np.tile(machine.home, (POSTURES, 1))
    postures[:, 0] += 0.3 * np.sin(phase)
    postures[:, 1] += 0.05 * np.sin(2.0 * phase)
    return Job(machine, postures, np.gradient(postures, DT_S, axis=0))


def poles(count: int) -> list[Box]:
    """Poles on both sides of the track, the middle ones beside the machine."""
    along = (np.arange(count // 2) - count // 4) * SPACING_M + 6.0
    return [
        Box(frozen(translation(x, side, POLE[2] + GROUND_M)), frozen(POLE))
        for x in along
        for side in (SIDE_M, -SIDE_M)
    ]


def limit(name: str, solid: Box | Surface, **facts: Any) -> Limit:
    """A limit around a solid."""
    return Limit(name, LimitKind.POINT, name, solid, "benchmark", Source("benchmark", name), **facts)


def pole_limits(boxes: list[Box]) -> list[Limit]:
    """One limit for each box."""
    return [limit(f"pole {i}", box) for i, box in enumerate(boxes)]


def terrain() -> Limit:
    """A rolling terrain of 2 x 224 x 224 triangles, half a metre wide."""
    n = 225
    x, y = np.meshgrid((np.arange(n) - n // 2) * 0.5, (np.arange(n) - n // 2) * 0.5, indexing="ij")
    z = GROUND_M - 0.15 + 0.1 * np.sin(x / 3.0) + 0.05 * np.cos(y / 2.0) + 0.01 * np.sin(37.0 * x + 53.0 * y)
    i = np.arange(n * n).reshape(n, n)
    a, b, c, d = i[:-1, :-1].ravel(), i[1:, :-1].ravel(), i[1:, 1:].ravel(), i[:-1, 1:].ravel()
    faces = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    surface = Surface(frozen(np.stack([x.ravel(), y.ravel(), z.ravel()], axis=1)), faces)
    return limit("terrain", surface, exempt_links=frozenset({"undercarriage"}))


def measured(step: Callable[[int], object], runs: int) -> float:
    """Return the median time of step(0), step(1)... [ms]."""
    for k in range(3):
        step(k)
    times = []
    for k in range(runs):
        before = time.perf_counter()
        step(k)
        times.append(time.perf_counter() - before)
    return 1e3 * statistics.median(times)


def stopping(machine: MachineModel, late: bool) -> MachineModel:
    """The machine with joints that stop at once, or late and known to some per cent only."""
    dead_s, lag_s, rest_s, tolerance = ROLLED_OUT

    def side(speeds: Floats) -> tuple[Stopping, ...]:
        return tuple(Stopping(dead_s, lag_s, v / rest_s, tolerance) if late else Stopping() for v in speeds.tolist())

    return replace(
        machine, stopping_positive=side(machine.speed_positive), stopping_negative=side(machine.speed_negative)
    )


def workgauge_step(
    given: Job,
    limits: list[Limit],
    *,
    unsure: bool = False,
    guard: str = "linear",
    late: bool = False,
    dt_s: float = DT_S,
) -> Callable[[int], object]:
    """A whole tick on the next posture, the gate open and the swing lever out, unsure of pose and joints or not."""
    given = replace(given, machine=stopping(given.machine, late))
    config: TickConfig = tick_config(given.machine, guard_named(guard), machine_id=ID, dt_s=dt_s, radius_m=SEARCH_M)
    warm_up(config)
    scene = Scene(given.machine, limits)
    pose = frozen(np.eye(4))
    covariance = frozen(np.diag(np.square([*POSITION_SIGMA_M, *TURN_SIGMA])) * unsure)
    joint_sigma = frozen(np.full(given.machine.n, JOINT_SIGMA) * unsure)
    period_ns = round(dt_s * 1e9)

    def inputs(ticks: int, q: Floats, side: float) -> TickInputs:
        """What enters the tick of this number, from 1."""
        now = ticks * period_ns
        stamp = Stamp(ID, now, "benchmark")
        opening = ticks <= 2  # the switch let go, then pressed with the levers in the middle
        levers = Levers() if opening else Levers(left_x=0.8 * side, right_y=-0.3 * side)
        return TickInputs(
            now,
            Posture(stamp, q, joint_sigma),
            MachinePose(stamp, pose, covariance),
            Intent(stamp, DriveMode.JOINT, levers, ticks > 1),
            scene,
        )

    memory, ticks = first_memory(config), 0
    drive = recorded(config, inputs) if late else []

    def step(k: int) -> object:
        nonlocal memory, ticks
        if drive:
            if k % len(drive) == 0:
                memory = first_memory(config)
            seen = drive[k % len(drive)]
        else:
            ticks += 1
            seen = inputs(ticks, given.postures[k % POSTURES], 1.0)
        _, memory, trace = tick(seen, memory, config)
        return trace

    return step


def recorded(config: TickConfig, inputs: Callable[[int, Floats, float], TickInputs]) -> list[TickInputs]:
    """Return what enters the ticks of a drive whose joints are as late as the machine's file says."""
    machine, memory, found = config.machine, first_memory(config), []
    joints = HydraulicJoints(machine, replace(HydraulicSpec.of_machine(machine), cylinders=()))
    q = machine.home
    for k in range(round(DRIVE_S / config.dt_s)):
        side = 1.0 if int(k * config.dt_s / SIDE_S) % 2 == 0 else -1.0
        found.append(inputs(k + 1, q, side))
        memory = tick(found[-1], memory, config)[1]
        joints.set_valves(memory.valves)
        q = frozen(joints.advance(config.dt_s, q))
    return found


def check(step: Callable[[int], Any]) -> None:
    """Make sure that the tick being timed is one that moves the machine and slows it at a pole."""
    traces = [step(k) for k in range(5 * POSTURES)]
    assert any(any(trace.valves) for trace in traces[10:]), "the gate never opened"
    assert min(trace.scale for trace in traces[10:]) < 1.0, "nothing was ever near"


def pink_step(given: Job, boxes: list[Box]) -> Callable[[int], object] | None:
    """Pink with a pinocchio collision model of all pairs."""
    if importlib.util.find_spec("pink") is None or len(boxes) > PINK_MOST_LIMITS:
        return None
    import coal
    import pinocchio as pin
    from pink import Configuration, solve_ik
    from pink.barriers import SelfCollisionBarrier
    from pink.limits import ConfigurationLimit, VelocityLimit
    from pink.tasks import PostureTask

    machine = given.machine
    model = machine.pinocchio_model()
    frames = [0, *(model.getFrameId(name) for name in machine.link_names[1:])]
    geometry = pin.GeometryModel()
    solids = []
    for solid in machine.solids:
        frame = model.frames[frames[solid.link]]
        placement = frame.placement * pin.SE3(np.array(solid.T_link_box))
        shape = coal.Box(*(2.0 * solid.half_extents).tolist())
        body = pin.GeometryObject(solid.name, frame.parentJoint, frames[solid.link], placement, shape)
        solids.append(geometry.addGeometryObject(body))
    others = []
    for i, box in enumerate(boxes):
        shape = coal.Box(*(2.0 * box.half_extents).tolist())
        body = pin.GeometryObject(f"pole{i}", 0, 0, pin.SE3(np.array(box.T_frame_box)), shape)
        others.append(geometry.addGeometryObject(body))
    paired = np.zeros((geometry.ngeoms, geometry.ngeoms), dtype=np.bool_)
    paired[np.ix_(solids, others)] = True
    for i, j in machine.self_pairs:
        paired[solids[i], solids[j]] = True
    geometry.setCollisionPairs(paired)
    configuration = Configuration(model, model.createData(), given.postures[0], collision_model=geometry)
    pairs = min(NEAREST_PAIRS, len(geometry.collisionPairs))
    barrier = SelfCollisionBarrier(pairs, d_min=STOP_M)
    task = PostureTask(cost=1.0)
    limits = [ConfigurationLimit(model), VelocityLimit(model)]

    def step(k: int) -> object:
        q = given.postures[k % POSTURES]
        configuration.update(q)
        task.set_target(q + given.wanted[k % POSTURES] * DT_S)
        return solve_ik(configuration, [task], DT_S, solver="daqp", limits=limits, barriers=[barrier])

    return step


def mink_step(given: Job, boxes: list[Box]) -> Callable[[int], object] | None:
    """Mink with a MuJoCo model of the same boxes and its collision avoidance limit."""
    if importlib.util.find_spec("mink") is None:
        return None
    import mink
    import mujoco

    machine = given.machine
    model = mujoco.MjModel.from_xml_string(mjcf(machine, boxes))
    links = [f"s{i}" for i in range(len(machine.solids))]
    pairs: list[Any] = [(links, [f"p{i}" for i in range(len(boxes))])]
    pairs += [([f"s{i}"], [f"s{j}"]) for i, j in machine.self_pairs]
    limits = [
        mink.ConfigurationLimit(model),
        mink.VelocityLimit(model, dict(zip(machine.joint_names, machine.speed_positive.tolist(), strict=True))),
        mink.CollisionAvoidanceLimit(
            model,
            pairs,
            minimum_distance_from_collisions=STOP_M,
            collision_detection_distance=SEARCH_M,
        ),
    ]
    configuration = mink.Configuration(model)
    task = mink.PostureTask(model, cost=1.0)

    def step(k: int) -> object:
        q = given.postures[k % POSTURES]
        configuration.update(q)
        task.set_target(q + given.wanted[k % POSTURES] * DT_S)
        return mink.solve_ik(configuration, [task], DT_S, "daqp", limits=limits)

    return step


def mjcf(machine: MachineModel, boxes: list[Box]) -> str:
    """The machine's joints and boxes, and the limits' boxes, in MuJoCo's description language."""

    def geoms(link: int, T_body_link: Floats) -> Iterator[str]:
        for i, solid in enumerate(machine.solids):
            if solid.link == link:
                yield geom(f"s{i}", T_body_link @ solid.T_link_box, solid.half_extents)

    lines = ['<mujoco><compiler angle="radian"/><worldbody>']
    poles_of_site = [geom(f"p{i}", box.T_frame_box, box.half_extents) for i, box in enumerate(boxes)]
    lines += ['<body name="site" mocap="true">', *poles_of_site, "</body>"]
    lines += [f'<body name="{machine.link_names[0]}">', *geoms(0, np.eye(4))]
    T_parent_link = np.eye(4)
    for i, joint in enumerate(machine.chain):
        T = T_parent_link @ joint.T_parent_joint
        low, high = machine.sample_min[i], machine.sample_max[i]
        kind = "slide" if joint.prismatic else "hinge"
        lines += [
            f'<body name="{machine.link_names[i + 1]}" {place(T)}>',
            f'<joint name="{joint.name}" type="{kind}" axis="{numbers(joint.axis)}" range="{low} {high}"/>',
            '<inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>',
            *geoms(i + 1, joint.T_joint_link),
        ]
        T_parent_link = joint.T_joint_link
    return "".join([*lines, "</body>" * (machine.n + 1), "</worldbody></mujoco>"])


def geom(name: str, T: Floats, half: Floats) -> str:
    """One box of a MuJoCo model."""
    return f'<geom name="{name}" type="box" size="{numbers(half)}" {place(T)}/>'


def place(T: Floats) -> str:
    """A pose in MuJoCo's description language."""
    import pinocchio as pin

    x, y, z, w = pin.Quaternion(np.array(T[:3, :3])).coeffs()
    return f'pos="{numbers(T[:3, 3])}" quat="{numbers((w, x, y, z))}"'


def numbers(values: Any) -> str:
    """Numbers as text that reads back exactly."""
    return " ".join(repr(float(value)) for value in values)


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", action="store_true", help="print one JSON object instead of a table")
    parser.add_argument("--rows", type=int, nargs="*", default=list(ROWS), help="numbers of limits")
    asked = parser.parse_args()
    given = job()
    rows = []
    for count in asked.rows:
        boxes = poles(count)
        ours = workgauge_step(given, pole_limits(boxes))
        unsure = workgauge_step(given, pole_limits(boxes), unsure=True)
        check(ours)
        check(unsure)
        row: dict[str, float | int | None] = {"limits": count}
        row |= {"workgauge_ms": measured(ours, 1000), "unsure_ms": measured(unsure, 1000)}
        for name, late in (("barrier_ms", False), ("barrier_rollout_ms", True)):
            barrier = workgauge_step(given, pole_limits(boxes), guard="barrier", late=late)
            check(barrier)
            row[name] = measured(barrier, 1000)
        for name, make, runs in (("pink_ms", pink_step, 100_000 // count), ("mink_ms", mink_step, 500)):
            step = make(given, boxes)
            row[name] = None if step is None else measured(step, min(runs, 300))
        for name in ("pink", "mink"):
            took, ours_took = row[f"{name}_ms"], row["barrier_ms"]
            row[f"{name}_over_barrier"] = took / ours_took if took and ours_took else None
        rows.append(row)
        print(row, file=sys.stderr) if not asked.json else None
    ground = workgauge_step(given, [*pole_limits(poles(10)), terrain()])
    check(ground)
    answer = {"rows": rows, "terrain_ms": measured(ground, 1000)}
    if asked.json:
        print(json.dumps(answer))
    else:
        print(f"with a terrain of 100,352 triangles: {answer['terrain_ms']:.3f} ms")


if __name__ == "__main__":
    main()
