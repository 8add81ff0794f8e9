"""The whole tick, with real machines, real limits and the kinematic plant."""

import functools
import json
import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from workgauge.guard.registry import guard_named
from workgauge.loop.config import TickConfig, search_radius_m, tick_config
from workgauge.loop.inputs import TickInputs
from workgauge.loop.memory import TickMemory, first_memory, restored
from workgauge.loop.tick import Trace, tick
from workgauge.machine.load import load_machine
from workgauge.proximity.protection import Integrity
from workgauge.proximity.scene import Scene
from workgauge.sim.kinematic import KinematicPlant
from workgauge.values import transforms as tf
from workgauge.values.arrays import frozen
from workgauge.values.errors import InputError
from workgauge.values.health import HealthState, PositionHealth
from workgauge.values.limits import Limit, LimitKind, Source
from workgauge.values.measurements import DriveMode, Intent, Levers, MachinePose, Posture, Stamp, ToolLine
from workgauge.values.reasons import STOPPING, Reason, ReasonCode
from workgauge.values.solids import Box
from workgauge.wire.messages import decode, decode_command

ID = "m1"
MS = 1_000_000
machine_named = functools.cache(load_machine)

PLACE = frozen(tf.translation(3.0, 4.0, 0.0) @ tf.rotation_z(0.3))


def pole(x: float, y: float) -> Limit:
    """A pole at machine coordinates x, y of the machine at PLACE."""
    solid = Box(frozen(PLACE @ tf.translation(x, y, 3.0)), frozen([0.15, 0.15, 4.0]))
    return Limit("pole", LimitKind.POINT, "Pole 1", solid, "poles", Source("test", "pole"))


@functools.cache
def setup(name: str = "rre20") -> tuple[TickConfig, Scene]:
    machine = machine_named(name)
    tool = machine.tool_pose(machine.forward(machine.home))[:3, 3]
    config = tick_config(machine, guard_named("linear"), machine_id=ID, tool_sigma_m=0.0)
    return config, Scene(machine, [pole(float(tool[0]), float(tool[1]) + 3.0)])


@dataclass(frozen=True)
class Step:
    """One tick of a run: what went in, what came out."""

    inputs: TickInputs
    frame: bytes
    memory: TickMemory
    trace: Trace
    truth: np.ndarray


def run(
    intents: Iterable[Intent],
    *,
    name: str = "rre20",
    spoil: Callable[[int, TickInputs], TickInputs] = lambda k, inputs: inputs,
    keep: Callable[[int, TickMemory], TickMemory] = lambda k, memory: memory,
) -> list[Step]:
    """Drive the plant through the loop; `spoil` may tamper with what enters, `keep` with the memory."""
    config, scene = setup(name)
    plant = KinematicPlant(config.machine, machine_id=ID, q=config.machine.home, T_site_machine=PLACE)
    memory, steps = first_memory(config), []
    posture = pose = None
    for k, intent in enumerate(intents):
        for chunk in plant.read():
            value = decode(chunk.data, plant.now_ns).value
            if isinstance(value, Posture):
                posture = value
            elif isinstance(value, MachinePose):
                pose = value
        stamped = replace(intent, stamp=Stamp(ID, plant.now_ns, "operator"))
        inputs = spoil(k, TickInputs(plant.now_ns, posture, pose, stamped, scene))
        outputs, memory, trace = tick(inputs, keep(k, memory), config)
        plant.write(outputs.frame)
        plant.advance(config.dt_s)
        steps.append(Step(inputs, outputs.frame, memory, trace, plant.truth[0]))
    return steps


def intent(mode: DriveMode = DriveMode.JOINT, *, enable: bool = True, line: ToolLine | None = None, **levers: float):
    return Intent(Stamp(ID, 0, "operator"), mode, Levers(**levers), enable, line)


#: The switch let go, then pressed with the levers in the middle: the gate opens.
PRESS = [intent(enable=False), intent()]


def sideways_line(name: str = "rre20") -> ToolLine:
    machine = machine_named(name)
    tool = PLACE @ machine.tool_pose(machine.forward(machine.home))
    return ToolLine(frozen(tool[:3, 3]), frozen(PLACE[:3, 1]))


def codes(trace: Trace) -> set[ReasonCode]:
    return {reason.code for reason in trace.reasons}


def true_clearance(step: Step) -> float:
    """Distance to the pole at the true posture after the tick."""
    _, scene = setup()
    clearances = scene.query(machine_named("rre20").forward(step.truth), PLACE, 20.0)
    return min(c.distance_m for c in clearances if c.limit == "pole")


def test_born_still_and_opened_by_the_switch() -> None:
    held = run([intent(left_x=1.0)] * 5)
    assert all(decode_command(s.frame, 0).value.neutral and ReasonCode.GATE_CLOSED in codes(s.trace) for s in held)
    steps = run([*PRESS, *[intent(left_x=1.0)] * 5])
    assert codes(steps[0].trace) == {ReasonCode.NOT_ENABLED}
    assert steps[1].trace.reasons == ()
    assert steps[-1].trace.valves[0] < 0 and steps[-1].truth[0] < 0.0


def test_driven_at_a_pole_and_back() -> None:
    """The tool on a straight line at a pole, then back: it settles at 0.2 m and the way back is unhindered."""
    line = sideways_line()
    there = [intent(DriveMode.LINE, line=line, right_y=1.0)] * 700
    back = [intent(DriveMode.LINE, line=line, right_y=-1.0)] * 200
    steps = run([*PRESS, *there, *back])
    clearances = [true_clearance(step) for step in steps]
    assert min(clearances) >= 0.2
    assert clearances[701] <= 0.22
    slowed = [step.trace for step in steps if step.trace.scale < 1.0][2:]
    assert all(ReasonCode.LIMIT_NEAR in codes(t) for t in slowed) and len(slowed) > 100
    for step in steps[702:]:
        assert step.trace.scale == 1.0 and step.trace.reasons == ()
        assert step.trace.allowed.tobytes() == step.trace.desired.tobytes()
    assert clearances[-1] > 1.5


def test_in_the_zone_speed_falls_in_proportion() -> None:
    line = sideways_line()
    steps = run([*PRESS, *[intent(DriveMode.LINE, line=line, right_y=1.0)] * 400])
    near = [s.trace for s in steps if 0.0 < s.trace.scale < 1.0]
    assert near
    for trace in near:
        assert trace.clearances is not None
        nearest = min(c.distance_m for c in trace.clearances if c.limit == "pole")
        assert trace.scale == pytest.approx((nearest - 0.2) / 0.6, abs=1e-9)


Fault = Callable[[TickInputs], TickInputs]


def with_posture(change: Callable[[Posture], Posture | None]) -> Fault:
    return lambda i: replace(i, posture=change(i.posture) if i.posture else None)


def with_pose(change: Callable[[MachinePose], MachinePose | None]) -> Fault:
    return lambda i: replace(i, pose=change(i.pose) if i.pose else None)


def with_intent(change: Callable[[Intent], Intent | None]) -> Fault:
    return lambda i: replace(i, intent=change(i.intent) if i.intent else None)


def aged(value: Any, seconds: float) -> Any:
    stamp = value.stamp
    return replace(value, stamp=replace(stamp, monotonic_ns=stamp.monotonic_ns - round(seconds * 1e9)))


def foreign(value: Any) -> Any:
    return replace(value, stamp=replace(value.stamp, machine_id="m2"))


def changed(array: Sequence[float] | np.ndarray, index: Any, value: float) -> np.ndarray:
    out = np.array(array)
    out[index] = value
    return frozen(out)


def with_health(state: HealthState, *said: ReasonCode) -> Fault:
    reasons = tuple(Reason(code, f"because of {code}") for code in said)
    return lambda i: replace(i, health=PositionHealth(state, i.now_ns, reasons))


#: Covariance of a pose by two RTK receivers and an inclinometer.
SURE = frozen(np.diag(np.square([0.015, 0.015, 0.025, 0.001, 0.001, 0.0026])))

FAULTS: dict[str, tuple[Fault, ReasonCode]] = {
    "no posture": (with_posture(lambda p: None), ReasonCode.NO_POSTURE),
    "no pose": (with_pose(lambda p: None), ReasonCode.NO_POSE),
    "no intent": (with_intent(lambda p: None), ReasonCode.NO_INTENT),
    "old posture": (with_posture(lambda p: aged(p, 0.11)), ReasonCode.STALE_POSTURE),
    "old pose": (with_pose(lambda p: aged(p, 0.21)), ReasonCode.STALE_POSE),
    "old intent": (with_intent(lambda p: aged(p, 0.21)), ReasonCode.STALE_INTENT),
    "future posture": (with_posture(lambda p: aged(p, -0.001)), ReasonCode.FROM_FUTURE),
    "future pose": (with_pose(lambda p: aged(p, -0.001)), ReasonCode.FROM_FUTURE),
    "future intent": (with_intent(lambda p: aged(p, -0.001)), ReasonCode.FROM_FUTURE),
    "foreign posture": (with_posture(foreign), ReasonCode.INVALID_VALUE),
    "foreign pose": (with_pose(foreign), ReasonCode.INVALID_VALUE),
    "foreign intent": (with_intent(foreign), ReasonCode.INVALID_VALUE),
    "q NaN": (with_posture(lambda p: replace(p, q=changed(p.q, 2, math.nan))), ReasonCode.INVALID_VALUE),
    "q infinite": (with_posture(lambda p: replace(p, q=changed(p.q, 2, math.inf))), ReasonCode.INVALID_VALUE),
    "q huge": (with_posture(lambda p: replace(p, q=changed(p.q, 2, 1e300))), ReasonCode.INVALID_VALUE),
    "q short": (with_posture(lambda p: replace(p, q=frozen(p.q[:-1]))), ReasonCode.INVALID_VALUE),
    "sigma short": (with_posture(lambda p: replace(p, sigma=frozen(p.sigma[:-1]))), ReasonCode.INVALID_VALUE),
    "sigma NaN": (with_posture(lambda p: replace(p, sigma=changed(p.sigma, 0, math.nan))), ReasonCode.INVALID_VALUE),
    "sigma negative": (
        with_posture(lambda p: replace(p, sigma=changed(p.sigma, 0, -1e-3))),
        ReasonCode.INVALID_VALUE,
    ),
    "pose NaN": (
        with_pose(lambda p: replace(p, T_site_machine=changed(p.T_site_machine, (0, 3), math.nan))),
        ReasonCode.INVALID_VALUE,
    ),
    "pose far": (
        with_pose(lambda p: replace(p, T_site_machine=changed(p.T_site_machine, (1, 3), 1e12))),
        ReasonCode.INVALID_VALUE,
    ),
    "attitude NaN": (
        with_pose(lambda p: replace(p, T_site_machine=changed(p.T_site_machine, (2, 2), math.nan))),
        ReasonCode.INVALID_VALUE,
    ),
    "attitude stretched": (
        with_pose(lambda p: replace(p, T_site_machine=changed(p.T_site_machine, (0, 0), 1.1))),
        ReasonCode.INVALID_VALUE,
    ),
    "attitude mirrored": (
        with_pose(lambda p: replace(p, T_site_machine=frozen(p.T_site_machine @ np.diag([1.0, 1, -1, 1])))),
        ReasonCode.INVALID_VALUE,
    ),
    "attitude zero": (
        with_pose(lambda p: replace(p, T_site_machine=frozen(np.diag([0.0, 0, 0, 1])))),
        ReasonCode.INVALID_VALUE,
    ),
    "pose short": (with_pose(lambda p: replace(p, T_site_machine=frozen(np.eye(3)))), ReasonCode.INVALID_VALUE),
    "covariance NaN": (
        with_pose(lambda p: replace(p, covariance=changed(p.covariance, (1, 1), math.nan))),
        ReasonCode.INVALID_VALUE,
    ),
    "variance negative": (
        with_pose(lambda p: replace(p, covariance=changed(p.covariance, (1, 1), -1.0))),
        ReasonCode.INVALID_VALUE,
    ),
    "variance too small for its correlation": (
        with_pose(lambda p: replace(p, covariance=changed(p.covariance, (0, 1), 1e-9))),
        ReasonCode.INVALID_VALUE,
    ),
    "covariance infinite": (
        with_pose(lambda p: replace(p, covariance=changed(p.covariance, (5, 5), math.inf))),
        ReasonCode.INVALID_VALUE,
    ),
    "covariance not symmetric": (
        with_pose(lambda p: replace(p, covariance=changed(np.eye(6) * 1e-4, (0, 1), 1e-5))),
        ReasonCode.INVALID_VALUE,
    ),
    "covariance not positive": (
        with_pose(lambda p: replace(p, covariance=frozen(1e-4 * (1.2 * np.ones((6, 6)) - 0.2 * np.eye(6))))),
        ReasonCode.INVALID_VALUE,
    ),
    "covariance short": (with_pose(lambda p: replace(p, covariance=frozen(np.eye(5)))), ReasonCode.INVALID_VALUE),
    "cross NaN": (
        with_pose(lambda p: replace(p, covariance=SURE, cross=frozen(np.full((6, 6), math.nan)))),
        ReasonCode.INVALID_VALUE,
    ),
    "cross with exact joints": (
        with_pose(lambda p: replace(p, covariance=SURE, cross=frozen(np.full((6, 6), 1e-6)))),
        ReasonCode.INVALID_VALUE,
    ),
    "cross short": (
        with_pose(lambda p: replace(p, covariance=SURE, cross=frozen(np.zeros((6, 5))))),
        ReasonCode.INVALID_VALUE,
    ),
    "joint covariance short": (
        with_posture(lambda p: replace(p, covariance=frozen(np.zeros((5, 5))))),
        ReasonCode.INVALID_VALUE,
    ),
    "joint covariance of other joints": (
        with_posture(lambda p: replace(p, covariance=frozen(np.eye(6) * 1e-6))),
        ReasonCode.INVALID_VALUE,
    ),
    "joint covariance not positive": (
        with_posture(
            lambda p: replace(
                p, sigma=frozen([1e-3] * 6), covariance=frozen(1e-6 * (2 * np.ones((6, 6)) - np.eye(6)))
            )
        ),
        ReasonCode.INVALID_VALUE,
    ),
    "position far too uncertain": (
        with_pose(lambda p: replace(p, covariance=frozen(SURE * 1e4))),
        ReasonCode.POSITION_UNSURE,
    ),
    "joints far too uncertain": (
        with_posture(lambda p: replace(p, sigma=frozen([0.1] * 6))),
        ReasonCode.POSITION_UNSURE,
    ),
    "health says stop": (
        with_health(HealthState.STOP, ReasonCode.POSITION_JUMP),
        ReasonCode.POSITION_LOST,
    ),
    "health stops with its own reason": (
        with_health(HealthState.STOP, ReasonCode.NOT_CHECKED),
        ReasonCode.NOT_CHECKED,
    ),
    "a reason that stops in a usable state": (
        with_health(HealthState.FIXED, ReasonCode.POSITION_LOST),
        ReasonCode.POSITION_LOST,
    ),
    "lever NaN": (with_intent(lambda p: replace(p, levers=Levers(math.nan))), ReasonCode.INVALID_VALUE),
    "lever beyond": (with_intent(lambda p: replace(p, levers=Levers(1.01))), ReasonCode.INVALID_VALUE),
    "no line": (with_intent(lambda p: replace(p, mode=DriveMode.LINE, line=None)), ReasonCode.INVALID_VALUE),
    "line far": (
        with_intent(
            lambda p: replace(p, mode=DriveMode.LINE, line=ToolLine(frozen([1e9, 0, 0]), frozen([1.0, 0, 0])))
        ),
        ReasonCode.INVALID_VALUE,
    ),
    "switch let go": (with_intent(lambda p: replace(p, enable=False)), ReasonCode.NOT_ENABLED),
}


@pytest.mark.parametrize("name", FAULTS)
def test_a_missing_old_or_impossible_input_stops_at_once_with_the_reason(name: str) -> None:
    fault, code = FAULTS[name]
    moving = [*PRESS, *[intent(left_x=1.0, right_y=-0.6)] * 6]
    steps = run(moving, spoil=lambda k, inputs: fault(inputs) if k == 7 else inputs)
    assert steps[6].trace.valves != (0,) * 6
    last = steps[7]
    assert decode_command(last.frame, 0).value.neutral and last.trace.valves == (0,) * 6
    assert last.trace.scale == 0.0
    assert code in codes(last.trace) and code in STOPPING
    assert not last.trace.allowed.any()


@settings(max_examples=60, deadline=None)
@given(st.lists(st.sampled_from([None, None, None, *FAULTS]), min_size=5, max_size=25), st.randoms())
def test_whatever_goes_wrong_when_the_valves_are_closed_while_it_lasts(faults: list[str | None], random: Any) -> None:
    drive = [intent(left_x=random.uniform(-1, 1), left_y=random.uniform(-1, 1)) for _ in faults]
    levers = [*PRESS, *[lever if random.random() < 0.8 else PRESS[k % 2] for k, lever in enumerate(drive)]]

    def spoil(k: int, inputs: TickInputs) -> TickInputs:
        name = faults[k - 2] if k >= 2 else None
        return FAULTS[name][0](inputs) if name else inputs

    for k, step in enumerate(run(levers, spoil=spoil)):
        if k >= 2 and (name := faults[k - 2]):
            assert decode_command(step.frame, 0).value.neutral
            assert FAULTS[name][1] in codes(step.trace)
        if not any(step.trace.valves) and max(map(abs, levers[k].levers.values)) > 0.3:
            assert step.trace.reasons


numbers = st.floats(width=64)


@settings(max_examples=150, deadline=None)
@given(
    st.lists(numbers, min_size=0, max_size=7),
    st.lists(numbers, min_size=16, max_size=16),
    st.lists(numbers, min_size=6, max_size=6),
    st.lists(numbers, min_size=6, max_size=6),
    st.sampled_from(DriveMode),
    st.integers(-(2**62), 2**62),
)
def test_no_measurement_makes_it_raise(
    q: list[float], T: list[float], levers: list[float], line: list[float], mode: DriveMode, at: int
) -> None:
    config, scene = setup()
    opened = run(PRESS)[-1].memory
    stamp = Stamp(ID, 40 * MS, "s")
    good = MachinePose.exact(stamp, PLACE), Posture.exact(stamp, config.machine.home)
    wild = MachinePose.exact(replace(stamp, monotonic_ns=at), frozen(np.reshape(T, (4, 4))))
    asked = Intent(stamp, mode, Levers(*levers), True, ToolLine(frozen(line[:3]), frozen(line[3:])))
    for posture, pose in ((Posture.exact(stamp, frozen(q)), good[0]), (good[1], wild), (good[1], good[0])):
        outputs, _, trace = tick(TickInputs(40 * MS, posture, pose, asked, scene), opened, config)
        command = decode_command(outputs.frame, 0).value
        assert np.isfinite(trace.allowed).all()
        assert command.neutral or (posture is good[1] and pose is good[0])


@settings(max_examples=100, deadline=None)
@given(
    st.lists(st.tuples(st.integers(0, 5), st.integers(0, 5), numbers), min_size=1, max_size=4),
    st.lists(st.tuples(st.integers(0, 5), numbers), max_size=2),
    st.booleans(),
)
def test_a_covariance_that_is_none_stops_and_never_makes_a_level_smaller(
    places: list[tuple[int, int, float]], sigmas: list[tuple[int, float]], both_sides: bool
) -> None:
    config, scene = setup()
    opened = run(PRESS)[-1].memory
    stamp = Stamp(ID, 40 * MS, "s")
    asked = Intent(stamp, DriveMode.JOINT, Levers(left_x=1.0), True)
    covariance, sigma = np.zeros((6, 6)), np.zeros(6)
    for i, j, value in places:
        covariance[i, j] = value
        if both_sides:
            covariance[j, i] = value
    for j, value in sigmas:
        sigma[j] = value
    pose, posture = MachinePose(stamp, PLACE, frozen(covariance)), Posture(stamp, config.machine.home, frozen(sigma))
    _, _, trace = tick(TickInputs(40 * MS, posture, pose, asked, scene), opened, config)
    if trace.clearances is not None:
        assert (trace.clearances.protections >= 0.0).all()
        assert np.linalg.eigvalsh(covariance)[0] >= -1e-6 * np.abs(covariance).max() and (sigma >= 0.0).all()
    else:
        assert ReasonCode.INVALID_VALUE in codes(trace)
    if trace.allowed.any():
        assert trace.clearances is not None and np.isfinite(trace.clearances.protections).all()


def test_reasons_of_a_usable_position_are_passed_on_and_stop_nothing() -> None:
    states = [state for state in HealthState if state.usable]
    drive = [*PRESS, *[intent(left_x=1.0)] * len(states)]

    def spoil(k: int, inputs: TickInputs) -> TickInputs:
        return with_health(states[k - 2], ReasonCode.POSITION_DEGRADED)(inputs) if k >= 2 else inputs

    for step, state in zip(run(drive, spoil=spoil)[2:], states, strict=True):
        assert step.inputs.health is not None and step.inputs.health.state is state
        assert codes(step.trace) == {ReasonCode.POSITION_DEGRADED} and any(step.trace.valves)


def test_what_stops_for_the_position_says_all_of_it_first() -> None:
    fault = with_health(HealthState.STOP, ReasonCode.POSITION_JUMP, ReasonCode.RECEIVER_FROZEN)
    trace = run([*PRESS, intent(left_x=1.0)], spoil=lambda k, i: fault(replace(i, pose=None)) if k == 2 else i)[
        -1
    ].trace
    assert [reason.code for reason in trace.reasons] == [
        ReasonCode.POSITION_JUMP,
        ReasonCode.RECEIVER_FROZEN,
        ReasonCode.POSITION_LOST,
        ReasonCode.NO_POSE,
    ]
    assert trace.clearances is None and trace.q is not None


def unsure(inputs: TickInputs) -> TickInputs:
    """The inputs as two RTK receivers and good joint sensors give them."""
    assert inputs.pose is not None and inputs.posture is not None
    pose, posture = replace(inputs.pose, covariance=SURE), replace(inputs.posture, sigma=frozen([0.0018] * 6))
    return replace(inputs, pose=pose, posture=posture)


def test_driven_at_a_pole_by_unsure_sensors_it_stops_that_much_farther_away_and_backs_away_freely() -> None:
    line = sideways_line()
    there = [intent(DriveMode.LINE, line=line, right_y=1.0)] * 700
    back = [intent(DriveMode.LINE, line=line, right_y=-1.0)] * 100
    steps = run([*PRESS, *there, *back], spoil=lambda k, inputs: unsure(inputs))
    last = steps[701]
    assert last.trace.clearances is not None
    nearest = min(
        (c for c in last.trace.clearances if c.limit == "pole"), key=lambda c: c.distance_m - c.protection_m
    )
    assert 0.08 < nearest.protection_m < 0.4
    assert true_clearance(last) == pytest.approx(0.2 + nearest.protection_m, abs=0.02)
    (reason,) = [reason for reason in last.trace.reasons if reason.limit == "pole"][:1]
    assert reason.protection_m == pytest.approx(nearest.protection_m) and reason.stop_distance_m == 0.2
    assert reason.clearance_m == pytest.approx(nearest.distance_m)
    for step in steps[702:]:
        assert step.trace.scale == 1.0 and step.trace.reasons == ()


def test_what_cannot_be_seen_within_the_radius_stops_with_both_numbers() -> None:
    config, scene = setup()
    drive = [*PRESS, *[intent(left_x=1.0)] * 2]

    def blurred(sigma: float) -> Trace:
        covariance = frozen(np.diag([sigma**2] * 3 + [0.0] * 3))
        return run(drive, spoil=lambda k, i: with_pose(lambda p: replace(p, covariance=covariance))(i))[-1].trace

    covered = config.radius_m - config.guard.reach_m - scene.largest_stop_m
    enough = covered / config.integrity.k / math.sqrt(3.0)
    assert any(blurred(0.99 * enough).valves)
    trace = blurred(1.01 * enough)
    (reason,) = trace.reasons
    assert reason.code is ReasonCode.POSITION_UNSURE and not any(trace.valves)
    assert reason.text == "clearances may be wrong up to 7.27 m, limits are known for 7.20 m"
    assert trace.clearances is not None and trace.clearances.protections.max() <= (reason.protection_m or 0.0)


def test_the_integrity_is_the_machine_files_unless_given() -> None:
    machine, guard = machine_named("rre20"), guard_named("linear")
    assert machine.positioning is not None
    config = tick_config(machine, guard, machine_id=ID)
    assert config.integrity == Integrity.of(machine.positioning.integrity)
    assert config.integrity.k == pytest.approx(5.3267, abs=1e-4) and config.tool_sigma_m == machine.tool_tolerance_m
    assert tick_config(machine_named("brokk5"), guard, machine_id=ID).integrity == config.integrity
    assert tick_config(machine, guard, machine_id=ID, integrity=Integrity(3.0, 0.1)).integrity == Integrity(3.0, 0.1)
    for wrong in (Integrity(0.0), Integrity(math.nan), Integrity(3.0, -0.1), Integrity(math.inf)):
        with pytest.raises(InputError, match="integrity"):
            tick_config(machine, guard, machine_id=ID, integrity=wrong)
    for sigma in (-0.1, math.nan):
        with pytest.raises(InputError, match="tool_sigma_m"):
            tick_config(machine, guard, machine_id=ID, tool_sigma_m=sigma)


def test_a_short_gap_stops_and_goes_on_and_a_long_one_needs_the_switch() -> None:
    def without_posture(first: int, last: int) -> Callable[[int, TickInputs], TickInputs]:
        old: list[Posture | None] = [None]

        def spoil(k: int, inputs: TickInputs) -> TickInputs:
            if k < first:
                old[0] = inputs.posture
            return replace(inputs, posture=old[0]) if first <= k < last else inputs

        return spoil

    drive = [*PRESS, *[intent(left_x=1.0)] * 40]
    short = run(drive, spoil=without_posture(10, 17))
    assert ReasonCode.STALE_POSTURE in codes(short[16].trace) and not any(short[16].trace.valves)
    assert any(short[20].trace.valves)
    long = run(drive, spoil=without_posture(10, 25))
    assert not any(any(step.trace.valves) for step in long[16:])
    assert codes(long[-1].trace) == {ReasonCode.GATE_CLOSED}


MIXED = [
    *PRESS,
    *[intent(left_x=0.7, right_y=-0.4)] * 10,
    *[intent(DriveMode.TOOL, left_y=0.5, right_roller=-0.6)] * 10,
    *[intent(DriveMode.LINE, line=sideways_line(), right_y=0.9)] * 40,
    *[intent(DriveMode.LINE, line=sideways_line(), right_y=-0.3)] * 5,
    *[intent(enable=False)] * 2,
    *[intent()],
    *[intent(left_x=-1.0, left_y=0.2)] * 8,
]


def told(steps: list[Step]) -> list[tuple[Any, ...]]:
    return [
        (s.frame, s.memory, s.trace.reasons, s.trace.scale, s.trace.allowed.tobytes(), s.truth.tobytes())
        for s in steps
    ]


@pytest.mark.parametrize("name", ["rre20", "brokk5"])
def test_the_same_run_twice_is_the_same_bit_for_bit(name: str) -> None:
    first = told(run(MIXED, name=name))
    assert first == told(run(MIXED, name=name))
    assert len({frame for frame, *_ in first}) == len(first)


def test_a_run_goes_on_from_a_restored_memory_bit_for_bit() -> None:
    through_json = run(MIXED, keep=lambda k, memory: restored(json.loads(json.dumps(memory.plain()))))
    assert told(through_json) == told(run(MIXED))


def test_every_memory_survives_its_plain_form() -> None:
    for step in run(MIXED):
        assert restored(json.loads(json.dumps(step.memory.plain()))) == step.memory


@pytest.mark.parametrize("broken", [{}, {"sequence": "x"}, {"sequence": 1, "valves": 3}, []])
def test_a_memory_that_is_none_is_refused(broken: Any) -> None:
    with pytest.raises(InputError, match="not a tick's memory"):
        restored(broken)


def test_a_broken_part_of_a_memory_is_refused() -> None:
    config, _ = setup()
    plain = first_memory(config).plain()
    for part in ("motion", "gate"):
        with pytest.raises(InputError):
            restored({**plain, part: {"what": 1}})


def test_nothing_of_the_inputs_is_written_to() -> None:
    step = run(MIXED[:20])[-1]
    config, _ = setup()
    memory = step.memory.plain()
    tick(step.inputs, step.memory, config)
    assert step.memory.plain() == memory
    assert not step.trace.allowed.flags.writeable and not step.trace.desired.flags.writeable


@pytest.mark.parametrize("levers", [{"left_x": 1.0, "left_roller": 0.9}, {"left_y": 0.4, "left_roller": -0.5}])
def test_joints_that_cannot_move_together_never_do(levers: dict[str, float]) -> None:
    machine = machine_named("brokk5")
    steps = run([*PRESS, *[intent(**levers)] * 20], name="brokk5")
    assert any(any(step.trace.valves) for step in steps)
    for step in steps[2:]:
        moving = [g for g in machine.exclusive_groups if any(step.trace.valves[j] for j in g)]
        assert len(moving) <= 1
        assert ReasonCode.EXCLUSIVE_GROUP in codes(step.trace)
        assert ReasonCode.GATE_CLOSED not in codes(step.trace)


def test_the_group_that_moves_goes_on_while_another_lever_is_pushed_alike() -> None:
    first = [intent(left_roller=0.8)] * 12
    steps = run([*PRESS, *first, *[intent(left_roller=0.8, left_x=0.85)] * 15], name="brokk5")
    assert all(step.trace.valves[1] and not step.trace.valves[0] for step in steps[2:])


def test_any_lever_off_the_middle_keeps_the_gate_shut_and_the_dead_zone_does_not() -> None:
    """The small excavator has no joint on the left roller: only the gate can hold it against the operator."""
    config, _ = setup("sun-a")
    assert "left_roller" not in config.machine.levers
    pushed = run([PRESS[0], intent(left_roller=0.5), intent(left_x=1.0)], name="sun-a")
    assert codes(pushed[1].trace) == {ReasonCode.NOT_NEUTRAL} and codes(pushed[2].trace) == {ReasonCode.GATE_CLOSED}
    resting = run([PRESS[0], intent(left_roller=0.05), intent(left_x=1.0)], name="sun-a")
    assert resting[1].trace.reasons == () and any(resting[2].trace.valves)


def test_a_work_state_that_is_off_frees_its_limits() -> None:
    config, _ = setup()
    near = pole(6.3, 1.2)
    scene = Scene(config.machine, [replace(near, activity=replace(near.activity, state="line live"))])
    line = sideways_line()
    drive = [*PRESS, *[intent(DriveMode.LINE, line=line, right_y=1.0)] * 20]
    held = run(drive, spoil=lambda k, i: replace(i, scene=scene))
    free = run(drive, spoil=lambda k, i: replace(i, scene=scene, off_states=frozenset({"line live"})))
    assert held[-1].trace.scale < 1.0 == free[-1].trace.scale


def test_a_limit_counts_only_in_its_own_time() -> None:
    config, _ = setup()
    near = pole(6.3, 1.2)
    scene = Scene(config.machine, [replace(near, activity=replace(near.activity, not_before_ns=300 * MS))])
    line = sideways_line()
    drive = [*PRESS, *[intent(DriveMode.LINE, line=line, right_y=1.0)] * 20]
    scales = [step.trace.scale for step in run(drive, spoil=lambda k, i: replace(i, scene=scene))[2:]]
    assert set(scales[:13]) == {1.0} and max(scales[13:]) < 1.0


def test_on_a_path_a_joint_at_its_end_stops_the_tool_instead_of_bending_the_path() -> None:
    machine = machine_named("rre20")
    tool = PLACE @ machine.tool_pose(machine.forward(machine.home))
    line = ToolLine(frozen(tool[:3, 3]), frozen(PLACE[:3, 0]))
    steps = run([*PRESS, *[intent(DriveMode.LINE, line=line, right_y=1.0)] * 250])
    assert ReasonCode.JOINT_END in codes(steps[-1].trace)
    for step in steps:
        off = (PLACE @ machine.tool_pose(machine.forward(step.truth)))[:3, 3] - tool[:3, 3]
        assert np.linalg.norm(off - (off @ PLACE[:3, 0]) * PLACE[:3, 0]) < 2e-3


def test_the_gate_never_vetoes_what_the_tick_makes_of_wild_levers() -> None:
    """What the drive does is within what the gate allows, however the levers are thrown about."""
    rng = np.random.default_rng(3)
    thrown = [
        intent(rng.choice(list(DriveMode)), line=sideways_line(), **dict(zip(Levers.__slots__, values, strict=True)))
        for values in rng.uniform(-1, 1, (150, 6))
    ]
    for name in ("rre20", "brokk5"):
        for step in run([*PRESS, *thrown], name=name)[2:]:
            assert not codes(step.trace) & {
                ReasonCode.GATE_CLOSED,
                ReasonCode.TOO_FAST_CHANGE,
                ReasonCode.OUT_OF_RANGE,
                ReasonCode.WRONG_SEQUENCE,
            }


@pytest.mark.parametrize(
    ("setting", "value"),
    [
        ("dt_s", 0.0),
        ("dt_s", math.nan),
        ("radius_m", 0.5),
        ("radius_m", math.nan),
        ("ramp_s", -1.0),
        ("posture_age_s", 0.0),
        ("pose_age_s", math.nan),
        ("intent_age_s", 100.0),
        ("machine_id", ""),
        ("machine_id", "m" * 33),
    ],
)
def test_settings_that_make_no_sense_are_refused_by_name(setting: str, value: Any) -> None:
    given_ = {"machine_id": ID, setting: value}
    with pytest.raises(InputError, match=setting):
        tick_config(machine_named("rre20"), guard_named("linear"), **given_)


def test_a_limit_that_keeps_its_distance_widens_the_search() -> None:
    guard, near = guard_named("linear"), pole(5.0, 5.0)
    assert search_radius_m(guard, []) == pytest.approx(3.8)
    assert search_radius_m(guard, [near, replace(near, stop_distance_m=5.0)]) == pytest.approx(8.8)
    assert search_radius_m(guard, [], protection_m=1.0) == pytest.approx(1.8)
