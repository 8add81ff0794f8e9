"""Each fault does what it says, to whom it is aimed at, for as long as it lasts, and nothing else."""

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from workgauge.sim.sensors.faults import BEFALLS, Fault, FaultKind
from workgauge.sim.sensors.line import corrupted
from workgauge.sim.sensors.randomness import generator
from workgauge.sim.sensors.settings import FixNoise, LinkSettings, ReceiverSettings, SensorSettings
from workgauge.values import transforms as tf
from workgauge.values.errors import GeodesyError, MachineError, ScenarioError
from workgauge.values.navigation import (
    EncoderReading,
    FixQuality,
    GnssFix,
    GnssHeading,
    GnssVelocity,
    Inclination,
)

MS = 1_000_000
FROM, UNTIL = 500 * MS, 1000 * MS
LATENCY = {"gnss-left": 20 * MS, "gnss-right": 20 * MS, "links": 10 * MS}
LEFT, RIGHT = "left receiver", "right receiver"

#: One fault of each kind, aimed at one victim.
FAULTS = [
    Fault(FaultKind.FLOAT, FROM, UNTIL, receiver=LEFT),
    Fault(FaultKind.DIFFERENTIAL, FROM, UNTIL, receiver=LEFT),
    Fault(FaultKind.SINGLE, FROM, UNTIL, receiver=LEFT),
    Fault(FaultKind.OUTAGE, FROM, UNTIL, receiver=LEFT),
    Fault(FaultKind.SILENCE, FROM, UNTIL, receiver=LEFT),
    Fault(FaultKind.SILENCE, FROM, UNTIL, sensor="boom imu"),
    Fault(FaultKind.SILENCE, FROM, UNTIL, port="links"),
    Fault(FaultKind.JUMP, FROM, UNTIL, receiver=LEFT, offset_m=(0.5, -0.3, 1.0)),
    Fault(FaultKind.FROZEN, FROM, UNTIL, receiver=LEFT),
    Fault(FaultKind.FROZEN, FROM, UNTIL, receiver=LEFT, clock_stopped=True),
    Fault(FaultKind.FROZEN, FROM, UNTIL, sensor="swing encoder"),
    Fault(FaultKind.SWAPPED, FROM, UNTIL),
    Fault(FaultKind.ANTENNA_MOVED, FROM, UNTIL, receiver=LEFT, offset_m=(0.0, 0.2, 0.0)),
    Fault(FaultKind.CORRECTION_AGE, FROM, UNTIL, receiver=LEFT),
    Fault(FaultKind.SENSOR_JUMP, FROM, UNTIL, sensor="boom imu", offset=0.1),
    Fault(FaultKind.BAD_BYTES, FROM, UNTIL, receiver=LEFT, flipped=0.02, dropped=0.02),
    Fault(FaultKind.FOREIGN_RECEIVER, FROM, UNTIL, receiver=LEFT, offset_m=(25.0, 0.0, 0.0)),
    Fault(FaultKind.CLOCK_STEP, FROM, UNTIL, receiver=LEFT, step_s=-3.0),
]


def name_of(fault: Fault) -> str:
    return f"{fault.kind}{'-stopped' if fault.clock_stopped else ''}-{fault.sensor or fault.port or 'receiver'}"


def moving(machine, for_ms: int = 1500):
    """Yield the states of a machine that travels, turns and moves its arm."""
    for t_ms in range(0, for_ms + 1, 10):
        t = t_ms * 1e-3
        T = tf.translation(1.5 * t, 0.7 * t, 0.0) @ tf.rotation_z(0.1 * t)
        yield t_ms * MS, machine.home + 0.2 * t * np.sign(0.5 * (machine.sample_min + machine.sample_max)), T


def heard(world: SimpleNamespace, *faults: Fault, machine=None, settings_: SensorSettings | None = None):
    machine = machine or world.MACHINES["rre20"]()
    kit = world.kit_of(machine, replace(settings_ or SensorSettings(), faults=faults))
    return world.hear(kit, moving(machine))


def victims(fault: Fault) -> set[str]:
    if fault.kind is FaultKind.SWAPPED:
        return {"gnss-left", "gnss-right"}
    return {"links"} if fault.sensor or fault.port else {"gnss-left"}


@pytest.mark.parametrize("fault", FAULTS, ids=name_of)
def test_a_fault_touches_its_victim_in_its_window_and_nothing_else(world: SimpleNamespace, fault: Fault) -> None:
    plain, faulty = heard(world), heard(world, fault)
    touched = set()
    for port in LATENCY:
        before, after = (
            {chunk.received_ns - LATENCY[port]: chunk.data for chunk in one.chunks if chunk.port == port}
            for one in (plain, faulty)
        )
        for t_ns in before | after:
            if before.get(t_ns) != after.get(t_ns):
                assert FROM <= t_ns < UNTIL, (port, t_ns)
                touched.add(port)
    assert touched == victims(fault)


def of_both(world: SimpleNamespace, fault: Fault, kind: type, source: str, exact: bool = True):
    """Return pairs (without, with the fault) of measurements of the same arrival within the window."""
    chosen = world.exact(sentences=("RMC", "GGA", "VTG", "GST")) if exact else None
    found = []
    for faults in ((), (fault,)):
        one = heard(world, *faults, settings_=chosen)
        found.append(
            {
                (m.stamp.monotonic_ns, getattr(m, "sentence", "")): m
                for m in one.of(kind, source)
                if FROM
                <= m.stamp.monotonic_ns - LATENCY[source.partition("/")[0] if "/" in source else "links"]
                < UNTIL
            }
        )
    return found


def left(world: SimpleNamespace, fault: Fault, kind: type = GnssFix):
    plain, faulty = of_both(world, fault, kind, "gnss-left/GN")
    assert plain
    return plain, faulty


def offset_m(world: SimpleNamespace, plain: GnssFix, faulty: GnssFix) -> np.ndarray:
    crs = world.frame_at().crs
    e, n = crs.from_geodetic([plain.latitude, faulty.latitude], [plain.longitude, faulty.longitude])
    return np.array([e[1] - e[0], n[1] - n[0], faulty.height_msl_m - plain.height_msl_m])


@pytest.mark.parametrize(
    ("kind", "quality"),
    [
        (FaultKind.FLOAT, FixQuality.FLOAT),
        (FaultKind.DIFFERENTIAL, FixQuality.DIFFERENTIAL),
        (FaultKind.SINGLE, FixQuality.SINGLE),
    ],
)
def test_a_worse_fix_is_stated_and_is_worse(world: SimpleNamespace, kind: FaultKind, quality: FixQuality) -> None:
    fault = Fault(kind, FROM, UNTIL, receiver=LEFT)
    plain, faulty = of_both(world, fault, GnssFix, "gnss-left/GN", exact=False)
    machine = world.MACHINES["rre20"]()
    sigma = getattr(machine.positioning.receivers[0].sigmas, f"{quality.name.lower()}_m")[0]
    assert {one.quality for one in faulty.values()} == {quality}
    moved = [offset_m(world, plain[key], faulty[key])[:2] for key in plain if key[1] == "GGA"]
    assert 0.3 * sigma < np.sqrt(np.mean(np.square(moved))) < 3.0 * sigma
    ages = {one.correction_age_s for one in faulty.values() if one.sentence == "GGA"}
    assert (ages == {1.0}) != (quality is FixQuality.SINGLE)


def test_an_outage_still_sends_but_has_no_fix(world: SimpleNamespace) -> None:
    plain, faulty = left(world, Fault(FaultKind.OUTAGE, FROM, UNTIL, receiver=LEFT))
    assert plain.keys() == faulty.keys()
    for one in faulty.values():
        assert one.quality is FixQuality.NONE
        assert math.isnan(one.latitude) and math.isnan(one.longitude) and math.isnan(one.height_msl_m)


def test_silence_sends_nothing(world: SimpleNamespace) -> None:
    _, faulty = left(world, Fault(FaultKind.SILENCE, FROM, UNTIL, receiver=LEFT))
    assert not faulty
    _, faulty = of_both(world, Fault(FaultKind.SILENCE, FROM, UNTIL, sensor="boom imu"), Inclination, "boom imu")
    assert not faulty


@pytest.mark.parametrize("ramp_s", [0.0, 0.3])
def test_a_jump_moves_the_position_and_no_more(world: SimpleNamespace, ramp_s: float) -> None:
    fault = Fault(FaultKind.JUMP, FROM, UNTIL, receiver=LEFT, offset_m=(0.5, -0.3, 1.0), ramp_s=ramp_s)
    plain, faulty = left(world, fault)
    assert plain.keys() == faulty.keys()
    for key, one in plain.items():
        if key[1] == "GGA":
            since_s = (key[0] - 20 * MS - FROM) * 1e-9
            share = min(since_s / ramp_s, 1.0) if ramp_s else 1.0
            assert offset_m(world, one, faulty[key]) == pytest.approx(share * np.array([0.5, -0.3, 1.0]), abs=1e-4)
        assert one.quality == faulty[key].quality
    plain, faulty = left(world, fault, GnssVelocity)
    assert all(one.speed_m_s == faulty[key].speed_m_s for key, one in plain.items())


@pytest.mark.parametrize("stopped", [False, True])
def test_a_frozen_receiver_repeats_itself(world: SimpleNamespace, stopped: bool) -> None:
    fault = Fault(FaultKind.FROZEN, FROM, UNTIL, receiver=LEFT, clock_stopped=stopped)
    plain, faulty = left(world, fault)
    assert plain.keys() == faulty.keys()
    places = {(one.latitude, one.longitude) for one in faulty.values()}
    assert len(places) == 1
    assert len({(one.latitude, one.longitude) for one in plain.values()}) == 10
    times = {one.stamp.epoch_ns for one in faulty.values()}
    assert len(times) == (1 if stopped else 10)
    if not stopped:
        assert times == {one.stamp.epoch_ns for one in plain.values()}


def test_swapped_antennas_turn_the_baseline_round(world: SimpleNamespace) -> None:
    fault = Fault(FaultKind.SWAPPED, FROM, UNTIL)
    plain_left, faulty_left = of_both(world, fault, GnssFix, "gnss-left/GN")
    plain_right, faulty_right = of_both(world, fault, GnssFix, "gnss-right/GN")
    for key in plain_left:
        assert (faulty_left[key].latitude, faulty_left[key].longitude) == (
            plain_right[key].latitude,
            plain_right[key].longitude,
        )
        assert faulty_right[key].longitude == plain_left[key].longitude
    machine = world.MACHINES["moving base"]()
    headings = [heard(world, *f, machine=machine, settings_=world.exact()).of(GnssHeading) for f in ((), (fault,))]
    for plain, faulty in zip(*headings, strict=True):
        hit = FROM <= plain.stamp.monotonic_ns - 20 * MS < UNTIL
        turn = math.remainder(faulty.heading - plain.heading, 2 * math.pi)
        assert abs(turn) == pytest.approx(math.pi if hit else 0.0, abs=1e-6)
        assert faulty.baseline_m == plain.baseline_m


def test_a_moved_antenna_makes_a_wrong_baseline(world: SimpleNamespace) -> None:
    """The cab's axes are x forward, y up, z to the right: 0.2 m to the right makes 2.2 m between antennas 2.0."""
    fault = Fault(FaultKind.ANTENNA_MOVED, FROM, UNTIL, receiver=LEFT, offset_m=(0.0, 0.0, 0.2))
    plain, faulty = left(world, fault)
    for key, one in plain.items():
        if key[1] == "GGA":
            assert np.linalg.norm(offset_m(world, one, faulty[key])) == pytest.approx(0.2, abs=1e-4)
    machine = world.MACHINES["moving base"]()
    found = heard(world, fault, machine=machine, settings_=world.exact()).of(GnssHeading)
    lengths = {round(one.baseline_m, 3): FROM <= one.stamp.monotonic_ns - 20 * MS < UNTIL for one in found}
    assert lengths == {2.2: False, 2.0: True}


def test_the_age_of_corrections_grows(world: SimpleNamespace) -> None:
    _, faulty = left(world, Fault(FaultKind.CORRECTION_AGE, FROM, UNTIL, receiver=LEFT))
    ages = [one.correction_age_s for one in faulty.values() if one.sentence == "GGA"]
    assert ages == pytest.approx([1.0 + 0.05 * k for k in range(10)], abs=0.051)
    assert ages[-1] > ages[0]


@pytest.mark.parametrize("joint", ["boom", "stick", "bucket"])
def test_a_jumped_inclinometer_reads_as_the_joint_turned(world: SimpleNamespace, joint: str) -> None:
    machine = world.MACHINES["rre20"]()
    j = machine.joint_names.index(joint)
    name = next(spec.sensor for spec in machine.positioning.joints if spec.joint == joint)
    T = tf.rotation_x(0.05) @ tf.rotation_y(-0.03)
    turned = np.array(machine.home)
    turned[j] += 0.1
    jump = Fault(FaultKind.SENSOR_JUMP, sensor=name, offset=0.1)
    said = []
    for q, faults in ((turned, ()), (machine.home, (jump,))):
        kit = world.kit_of(machine, world.exact(faults=faults))
        (one,) = world.hear(kit, [(0, q, T)]).of(Inclination, name)
        said.append((one.roll, one.pitch))
    assert said[0] == pytest.approx(said[1], abs=1e-9)


def test_a_jumped_encoder_is_off_by_the_angle(world: SimpleNamespace) -> None:
    fault = Fault(FaultKind.SENSOR_JUMP, FROM, UNTIL, sensor="swing encoder", offset=0.1)
    plain, faulty = of_both(world, fault, EncoderReading, "swing encoder")
    assert plain
    assert all(faulty[key].value - one.value == pytest.approx(0.1) for key, one in plain.items())


def test_bad_bytes_are_counted_and_give_nothing_false(world: SimpleNamespace) -> None:
    """What is decoded from a disturbed stream was sent just so; the rest is refused."""
    receivers = ReceiverSettings(protocol="both")
    fault = Fault(FaultKind.BAD_BYTES, FROM, UNTIL, port="gnss-left", flipped=0.01, dropped=0.005)
    plain, faulty = (heard(world, *f, settings_=SensorSettings(receivers)) for f in ((), (fault,)))
    said = {(fix.sentence, fix.latitude, fix.longitude) for fix in plain.of(GnssFix, "gnss-left")}
    for fix in faulty.of(GnssFix, "gnss-left"):
        assert (fix.sentence, fix.latitude, fix.longitude) in said
    assert faulty.tallies["gnss-left"].bad > 10
    assert faulty.tallies["gnss-right"].bad == 0


@pytest.mark.parametrize(("flipped", "dropped"), [(0.0, 0.0), (0.1, 0.0), (0.0, 0.1), (1.0, 0.0), (0.0, 1.0)])
def test_the_share_of_bad_bytes(flipped: float, dropped: float) -> None:
    data = bytes(range(256)) * 40
    hurt = corrupted(data, flipped, dropped, generator(1, "bytes"))
    assert len(data) - len(hurt) == pytest.approx(dropped * len(data), abs=4 * math.sqrt(len(data)) * dropped)
    if not dropped:
        bits = [(a ^ b).bit_count() for a, b in zip(data, hurt, strict=True)]
        assert set(bits) <= {0, 1}
        assert sum(bits) == pytest.approx(flipped * len(data), abs=4 * math.sqrt(len(data)) * flipped)


def test_a_foreign_receiver_speaks_in_between_under_its_own_talker(world: SimpleNamespace) -> None:
    fault = Fault(FaultKind.FOREIGN_RECEIVER, FROM, UNTIL, receiver=LEFT, offset_m=(25.0, 0.0, 0.0), talker="GP")
    plain, faulty = (heard(world, *f, settings_=world.exact()) for f in ((), (fault,)))
    assert {one.stamp.source for one in plain.of(GnssFix)} == {"gnss-left/GN", "gnss-right/GN"}
    own = {one.stamp.monotonic_ns: one for one in faulty.of(GnssFix, "gnss-left/GN") if one.sentence == "GGA"}
    foreign = [one for one in faulty.of(GnssFix, "gnss-left/GP") if one.sentence == "GGA"]
    assert len(foreign) == 10
    for one in foreign:
        assert offset_m(world, own[one.stamp.monotonic_ns], one) == pytest.approx([25.0, 0.0, 0.0], abs=1e-3)


@pytest.mark.parametrize("target", [{"receiver": LEFT}, {"sensor": "boom imu"}, {"port": "gnss-left"}])
def test_latency_delays_and_keeps_the_order(world: SimpleNamespace, target: dict[str, str]) -> None:
    fault = Fault(FaultKind.LATENCY, FROM, UNTIL, delay_s=0.2, **target)
    port = "links" if "sensor" in target else "gnss-left"
    kind, source = (Inclination, "boom imu") if "sensor" in target else (GnssFix, "gnss-left")
    plain, faulty = (heard(world, *f) for f in ((), (fault,)))
    pairs = list(zip(plain.of(kind, source), faulty.of(kind, source), strict=True))
    assert len(pairs) > 10
    for before, after in pairs:
        t_ns = before.stamp.monotonic_ns - LATENCY[port]
        late_ns = after.stamp.monotonic_ns - before.stamp.monotonic_ns
        if FROM <= t_ns < UNTIL:
            assert late_ns == 200 * MS
        elif t_ns < FROM:
            assert late_ns == 0
        else:  # waits for those before it
            assert late_ns == max(0, UNTIL + 200 * MS - _period_ns(kind) - t_ns)
    for other in LATENCY:
        if other != port:
            assert [c for c in plain.chunks if c.port == other] == [c for c in faulty.chunks if c.port == other]
    assert plain.tallies == faulty.tallies


def _period_ns(kind: type) -> int:
    return 10 * MS if kind is Inclination else 50 * MS


def test_a_clock_step_moves_the_time_said_and_not_the_time_heard(world: SimpleNamespace) -> None:
    plain, faulty = left(world, Fault(FaultKind.CLOCK_STEP, FROM, UNTIL, receiver=LEFT, step_s=-3.0))
    assert plain.keys() == faulty.keys()
    for key, one in plain.items():
        assert faulty[key].stamp.epoch_ns - one.stamp.epoch_ns == -3_000 * MS
        assert faulty[key].latitude == one.latitude


def test_faults_of_everyone_hit_every_receiver_and_the_moving_base(world: SimpleNamespace) -> None:
    fault = Fault(FaultKind.OUTAGE, FROM, UNTIL)
    found = heard(world, fault)
    for port in ("gnss-left/GN", "gnss-right/GN"):
        lost = [one for one in found.of(GnssFix, port) if one.quality is FixQuality.NONE and one.sentence == "GGA"]
        assert len(lost) == 10
    base = heard(world, fault, machine=world.MACHINES["moving base"]())
    assert sum(math.isnan(one.heading) for one in base.of(GnssHeading)) == 10
    named = heard(world, replace(fault, receiver="heading"), machine=world.MACHINES["moving base"]())
    assert sum(math.isnan(one.heading) for one in named.of(GnssHeading)) == 10
    assert all(one.quality is FixQuality.FIXED for one in named.of(GnssFix))


def test_a_frozen_moving_base_repeats_its_heading_and_a_late_one_comes_late(world: SimpleNamespace) -> None:
    machine = world.MACHINES["moving base"]()
    frozen, late = (
        heard(world, Fault(kind, FROM, UNTIL, receiver="heading", delay_s=0.3), machine=machine).of(GnssHeading)
        for kind in (FaultKind.FROZEN, FaultKind.LATENCY)
    )
    inside = [one for one in frozen if FROM <= one.stamp.monotonic_ns - 20 * MS < UNTIL]
    assert len(inside) == 10
    assert len({one.heading for one in inside}) == 1 < len({one.heading for one in frozen})
    assert len({one.time_of_day_s for one in inside}) == 10
    assert [one.time_of_day_s for one in late] == [one.time_of_day_s for one in frozen]
    delays = [one.stamp.monotonic_ns - other.stamp.monotonic_ns for one, other in zip(late, frozen, strict=True)]
    assert delays[:10] == [0] * 10 and delays[10:20] == [300 * MS] * 10


def test_of_several_faults_the_worst_counts(world: SimpleNamespace) -> None:
    float_, single = (Fault(kind, FROM, UNTIL, receiver=LEFT) for kind in (FaultKind.FLOAT, FaultKind.SINGLE))
    for faults in ((float_, single), (single, float_)):
        found = heard(world, *faults).of(GnssFix, "gnss-left")
        assert FixQuality.FLOAT not in {one.quality for one in found}
        assert FixQuality.SINGLE in {one.quality for one in found}


@pytest.mark.parametrize(
    ("fault", "element", "allowed"),
    [
        (Fault(FaultKind.FLOAT, receiver="middle receiver"), "faults.0.receiver", "left receiver, right receiver"),
        (Fault(FaultKind.SILENCE, sensor="boom"), "faults.0.sensor", "boom imu"),
        (Fault(FaultKind.SILENCE, port="gnss"), "faults.0.port", "gnss-left, gnss-right, links"),
        (Fault(FaultKind.JUMP, receiver="heading"), "faults.0.receiver", "left receiver, right receiver"),
        (Fault(FaultKind.SENSOR_JUMP), "faults.0", "boom imu"),
    ],
)
def test_a_fault_that_befalls_nothing_is_refused(
    world: SimpleNamespace, fault: Fault, element: str, allowed: str
) -> None:
    with pytest.raises(ScenarioError) as caught:
        heard(world, fault)
    assert caught.value.element == element
    assert allowed in str(caught.value.allowed)


def test_what_a_kit_needs(world: SimpleNamespace) -> None:
    machine = world.MACHINES["rre20"]()
    with pytest.raises(MachineError, match="positioning"):
        world.kit_of(replace(machine, positioning=None))
    from workgauge.sim.sensors.kit import SensorKit

    with pytest.raises(GeodesyError, match="coordinate system"):
        SensorKit(machine, None, world.frame_at())
    with pytest.raises(ScenarioError, match="no such receiver"):
        world.kit_of(machine, SensorSettings(each={"third": ReceiverSettings()}))
    with pytest.raises(MachineError, match="no such sensor"):
        world.kit_of(replace(machine, sensors=machine.sensors[1:]))
    odd = machine.positioning.receivers[0].model_copy(update={"talker": "PTNL"})
    section = machine.positioning.model_copy(update={"receivers": (odd,)})
    with pytest.raises(MachineError, match="talker"):
        world.kit_of(replace(machine, positioning=section))
    kit = world.kit_of(machine)
    kit.advance(10 * MS, machine.home, np.eye(4))
    with pytest.raises(ValueError, match="forwards"):
        kit.advance(9 * MS, machine.home, np.eye(4))
    with pytest.raises(ValueError, match="shape"):
        kit.advance(11 * MS, machine.home[:2], np.eye(4))


TARGETS = st.sampled_from([{}, {"receiver": LEFT}, {"receiver": RIGHT}, {"port": "links"}, {"sensor": "all"}])
SMALL = st.floats(-2.0, 2.0)


@st.composite
def any_fault(draw: st.DrawFn) -> Fault:
    kind = draw(st.sampled_from([one for one in FaultKind if one is not FaultKind.BAD_BYTES]))
    target = draw(TARGETS)
    group = "sensor" if "sensor" in target or target.get("port") == "links" else "receiver"
    if group not in BEFALLS[kind]:
        target = {"sensor": "all"} if group == "receiver" else {}
    start = draw(st.integers(0, 300))
    return Fault(
        kind,
        start * MS,
        draw(st.none() | st.integers(1, 400).map(lambda ms: (start + ms) * MS)),
        **target,
        offset_m=draw(st.tuples(SMALL, SMALL, SMALL)),
        ramp_s=draw(st.floats(0.0, 1.0)),
        offset=draw(SMALL),
        delay_s=draw(st.floats(0.0, 0.5)),
        step_s=draw(st.floats(-1e5, 1e5)),
        clock_stopped=draw(st.booleans()),
    )


@settings(max_examples=25, deadline=None)
@given(faults=st.lists(any_fault(), max_size=5), protocol=st.sampled_from(["nmea", "ubx", "both"]))
def test_whatever_goes_wrong_but_the_bytes_the_stream_is_in_order(
    world: SimpleNamespace, faults: list[Fault], protocol: str
) -> None:
    machine = world.MACHINES["rre20"]()
    chosen = SensorSettings(
        ReceiverSettings(protocol=protocol, noise=FixNoise(scale=2.0)),
        links=LinkSettings(rate_hz=50),
        faults=tuple(faults),
    )
    found = world.hear(world.kit_of(machine, chosen), moving(machine, 400))
    assert not any(tally.bad or tally.unknown for tally in found.tallies.values())
    arrivals = [chunk.received_ns for chunk in found.chunks]
    assert arrivals == sorted(arrivals)
