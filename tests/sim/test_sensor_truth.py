"""Without noise, the bytes of simulated sensors say what is true, to the last digit they carry."""

import math
from datetime import UTC, datetime
from types import SimpleNamespace

import numpy as np
import pinocchio as pin
import pyproj
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import PchipInterpolator
from scipy.spatial.transform import Rotation

from workgauge.sim.sensors.settings import LinkSettings
from workgauge.values.navigation import (
    AngularRate,
    EncoderReading,
    GnssFix,
    GnssHeading,
    GnssVelocity,
    Inclination,
)

MS = 1_000_000
MACHINES = ("rre20", "moving base", "brokk5", "sun-a")
SENTENCES = ("RMC", "GGA", "GST", "VTG", "GLL", "PTNL,GGK", "ZDA")
MESSAGES = ("NAV-PVT", "NAV-HPPOSLLH", "NAV-COV")

#: Half the last digit of a position [degree] and a height [m], by message; NMEA writes minutes with 8 decimals.
RESOLUTION_DEG = dict.fromkeys(("RMC", "GGA", "GLL", "PTNL,GGK"), 0.5e-8 / 60) | {
    "NAV-PVT": 0.5e-7,
    "NAV-HPPOSLLH": 0.5e-9,
}
HEIGHT_M = {"GGA": 0.5e-4, "PTNL,GGK": 0.5e-4, "NAV-PVT": 0.5e-3, "NAV-HPPOSLLH": 0.5e-4}


class Truth:
    """The machine in space by a kinematic model of its own and pyproj itself."""

    def __init__(self, machine, epsg: int, origin) -> None:
        self.machine = machine
        self.model = machine.pinocchio_model()
        self.data = self.model.createData()
        self.sensors = {sensor.name: sensor for sensor in machine.sensors}
        self.origin = np.array(origin)
        self.crs = pyproj.CRS.from_epsg(epsg)
        self.to_geodetic = pyproj.Transformer.from_crs(self.crs, self.crs.geodetic_crs, always_xy=True)

    def pose(self, name: str, q, T):
        """Return the frame of a sensor in the site (4, 4)."""
        pin.framesForwardKinematics(self.model, self.data, np.array(q))
        sensor = self.sensors[name]
        link = np.eye(4)
        if sensor.link:
            frame = self.model.getFrameId(self.machine.link_names[sensor.link])
            link = self.data.oMf[frame].homogeneous
        return np.array(T) @ link @ sensor.T_link_sensor

    def place(self, name: str, q, T) -> tuple[float, float, float]:
        """Return latitude, longitude [degree] and height of a sensor."""
        e, n, z = self.pose(name, q, T)[:3, 3] + self.origin
        lon, lat = self.to_geodetic.transform(e, n)
        return lat, lon, z

    def convergence(self, name: str, q, T) -> float:
        lat, lon, _ = self.place(name, q, T)
        return math.radians(pyproj.Proj(self.crs).get_factors(lon, lat).meridian_convergence)


def poses(machine):
    """Draw a posture and a pose of the machine within 2 km of the site's origin."""
    angle = st.floats(-0.3, 0.3)
    far = st.floats(-2000.0, 2000.0)
    unit = st.floats(0.0, 1.0)
    return st.tuples(
        st.tuples(*[unit] * machine.n).map(
            lambda u: machine.sample_min + np.array(u) * (machine.sample_max - machine.sample_min)
        ),
        st.builds(_pose, st.tuples(far, far, st.floats(-20.0, 20.0)), st.floats(-4.0, 4.0), angle, angle),
    )


def _pose(place, yaw: float, pitch: float, roll: float):
    T = np.eye(4)
    T[:3, :3] = Rotation.from_euler("ZYX", [yaw, pitch, roll]).as_matrix()
    T[:3, 3] = place
    return T


def turned(angle: float) -> float:
    return math.remainder(angle, 2 * math.pi)


@pytest.mark.parametrize("epsg", [3879, 25832])
@pytest.mark.parametrize("name", MACHINES)
@settings(max_examples=15, deadline=None)
@given(data=st.data())
def test_a_position_is_the_antennas_own(world: SimpleNamespace, name: str, epsg: int, data) -> None:
    machine = world.MACHINES[name]()
    truth = Truth(machine, epsg, world.PLACES[epsg])
    q, T = data.draw(poses(machine))
    kit = world.kit_of(
        machine,
        world.exact(protocol="both", sentences=SENTENCES, messages=MESSAGES, geoid_separation_m=23.5),
        epsg,
    )
    heard = world.hear(kit, [(0, q, T)])
    assert not any(tally.bad or tally.unknown for tally in heard.tallies.values())
    kinds = {"UBX": MESSAGES[:2]}
    for spec in machine.positioning.receivers:
        lat, lon, z = truth.place(spec.antenna, q, T)
        sources = [f"{spec.port}/{spec.talker}"] if spec.talker else [f"{spec.port}/{t}" for t in ("GN", "UBX")]
        for source in sources:
            fixes = heard.of(GnssFix, source)
            assert {one.sentence for one in fixes} >= set(kinds.get(source.rpartition("/")[2], ("GGA", "RMC", "GLL")))
            for fix in fixes:
                tolerance = RESOLUTION_DEG[fix.sentence] + 2e-12
                assert abs(math.degrees(fix.latitude) - lat) <= tolerance
                assert abs(math.degrees(fix.longitude) - lon) <= tolerance
                if fix.sentence in HEIGHT_M:
                    assert abs(fix.height_ellipsoid_m - (z + 23.5)) <= 2 * HEIGHT_M[fix.sentence] + 1e-9
                if not math.isnan(fix.height_msl_m):
                    assert abs(fix.height_msl_m - z) <= HEIGHT_M[fix.sentence] + 1e-9


@pytest.mark.parametrize("name", ["moving base", "brokk5"])
@pytest.mark.parametrize("epsg", [3879, 25832])
@settings(max_examples=15, deadline=None)
@given(data=st.data())
def test_a_moving_base_has_the_true_heading(world: SimpleNamespace, name: str, epsg: int, data) -> None:
    machine = world.MACHINES[name]()
    truth = Truth(machine, epsg, world.PLACES[epsg])
    q, T = data.draw(poses(machine))
    heard = world.hear(world.kit_of(machine, world.exact(), epsg), [(0, q, T)])
    (heading,) = heard.of(GnssHeading)
    spec = machine.positioning.heading
    master, rover = (truth.pose(antenna, q, T)[:3, 3] for antenna in (spec.master, spec.rover))
    east, north, up = rover - master
    true = math.atan2(east, north) + truth.convergence(spec.master, q, T)
    assert abs(turned(heading.heading - true)) <= math.radians(0.6e-5)
    assert abs(heading.pitch - math.atan2(up, math.hypot(east, north))) <= math.radians(0.6e-5)
    assert abs(heading.baseline_m - np.linalg.norm(rover - master)) <= 0.6e-4


@pytest.mark.parametrize("name", MACHINES)
@settings(max_examples=15, deadline=None)
@given(data=st.data())
def test_link_sensors_read_what_the_machines_file_says_of_them(world: SimpleNamespace, name: str, data) -> None:
    machine = world.MACHINES[name]()
    truth = Truth(machine, 3879, world.PLACES[3879])
    q, T = data.draw(poses(machine))
    heard = world.hear(world.kit_of(machine, world.exact()), [(0, q, T)])
    section = machine.positioning
    for reading in heard.of(Inclination):
        R = truth.pose(reading.stamp.source, q, T)[:3, :3]
        said = Rotation.from_euler("ZYX", [0.0, reading.pitch, reading.roll]).as_matrix()
        assert said[2] == pytest.approx(R[2], abs=1e-12)
    tilts = {one.stamp.source for one in heard.of(Inclination)}
    assert section.tilt.sensor in tilts
    for spec in section.joints:
        j = machine.joint_names.index(spec.joint)
        if spec.kind == "inclination":
            assert spec.sensor in tilts
            continue
        (reading,) = heard.of(EncoderReading, spec.sensor)
        offset = math.radians(spec.offset_deg)
        if spec.calibration is None:
            error = spec.sign * reading.value + offset - q[j]
            assert abs(turned(error) if machine.continuous[j] else error) < 1e-12
        else:
            positions = np.radians(spec.calibration.position_deg)
            curve = PchipInterpolator(spec.calibration.stroke_m, positions)
            assert abs(curve(spec.sign * reading.value) + offset - q[j]) < 1e-9


@pytest.mark.parametrize("name", MACHINES)
@settings(max_examples=8, deadline=None)
@given(data=st.data())
def test_velocities_and_turn_rates_are_those_of_the_motion(world: SimpleNamespace, name: str, data) -> None:
    """Against differences of true places, while every joint turns and the machine travels and yaws."""
    machine = world.MACHINES[name]()
    truth = Truth(machine, 3879, world.PLACES[3879])
    q0, T0 = data.draw(poses(machine))
    speed = np.array(data.draw(st.tuples(*[st.floats(-0.5, 0.5)] * machine.n)))
    speed[machine.prismatic] *= 0.1
    travel, yaw_rate = data.draw(st.floats(0.5, 3.0)), data.draw(st.floats(-0.3, 0.3))

    def state(t_s: float):
        T = np.array(T0)
        T[:3, :3] = Rotation.from_rotvec([0.0, 0.0, yaw_rate * t_s]).as_matrix() @ T0[:3, :3]
        T[:3, 3] += np.array([0.6, 0.8, 0.01]) * travel * t_s
        return np.clip(q0 + speed * (t_s - 0.05), machine.q_min, machine.q_max) if machine.n else q0, T

    settings_ = world.exact(
        protocol="both", messages=("NAV-PVT",), sentences=("RMC", "VTG"), links=LinkSettings(scale=0.0)
    )
    kit = world.kit_of(machine, settings_)
    h = 0.005
    heard = world.hear(kit, [(round(t * 1e9), *state(t)) for t in np.arange(0.0, 0.1001, h)])
    # what the kit calls velocity at 0.1 s is the constant rate from the state before
    small = 1e-5
    (qa, Ta), (qb, Tb) = state(0.1 - h), state(0.1)

    def between(s: float):
        qs = qa + (qb - qa) * s
        turn = Rotation.from_matrix(Tb[:3, :3] @ Ta[:3, :3].T).as_rotvec()
        T = np.array(Tb)
        T[:3, :3] = Rotation.from_rotvec(turn * (s - 1.0)).as_matrix() @ Tb[:3, :3]
        T[:3, 3] = Ta[:3, 3] + (Tb[:3, 3] - Ta[:3, 3]) * s
        return qs, T

    for spec in machine.positioning.receivers:
        there, back = (truth.pose(spec.antenna, *between(1.0 + sign * small)) for sign in (1, -1))
        east, north, up = (there[:3, 3] - back[:3, 3]) / (2 * small * h)
        course = math.atan2(east, north) + truth.convergence(spec.antenna, qb, Tb)
        found = [one for one in heard.of(GnssVelocity, spec.port) if _time_is(one, 0.1)]
        found = [one for one in found if one.stamp.source.endswith(spec.talker or "")]
        assert found
        for one in found:
            assert one.speed_m_s == pytest.approx(math.hypot(east, north), abs=1e-3)
            if one.speed_m_s > 0.2:
                assert abs(turned(one.course - course)) < 0.01 / one.speed_m_s
            if one.sentence == "NAV-PVT":
                assert one.climb_m_s == pytest.approx(up, abs=1e-3)
    rates = {one.stamp.source: one.rate for one in heard.of(AngularRate)}
    assert set(rates) == {sensor.name for sensor in machine.sensors if sensor.kind == "imu"}
    for imu, rate in rates.items():
        there, back = (truth.pose(imu, *between(1.0 + sign * small))[:3, :3] for sign in (1, -1))
        turn = Rotation.from_matrix(back.T @ there).as_rotvec() / (2 * small * h)
        assert rate == pytest.approx(turn, abs=1e-4)


def _time_is(one: GnssVelocity, t_s: float) -> bool:
    if one.stamp.epoch_ns is not None:
        return one.stamp.epoch_ns % 1_000_000_000 == round(t_s * 1e9)
    return abs(one.time_of_day_s % 1.0 - t_s) < 1e-6


def test_an_epoch_between_two_states_is_interpolated(world: SimpleNamespace) -> None:
    """States every 7 ms, epochs every 50 ms: the position is that of the epoch, not of a state near by."""
    machine = world.MACHINES["rre20"]()
    truth = Truth(machine, 3879, world.PLACES[3879])

    def state(t_s: float):
        q = machine.home + np.array([0.5 * t_s, *np.zeros(machine.n - 1)])
        return q, _pose((3.0 * t_s, 4.0 * t_s, 0.0), 0.2 * t_s, 0.0, 0.0)

    kit = world.kit_of(machine, world.exact(protocol="ubx", messages=("NAV-PVT", "NAV-HPPOSLLH")))
    heard = world.hear(kit, [(k * 7 * MS, *state(k * 7e-3)) for k in range(60)])
    fixes = [one for one in heard.of(GnssFix, "gnss-left") if one.sentence == "NAV-HPPOSLLH"]
    assert len(fixes) == 9
    for k, fix in enumerate(fixes):
        lat, lon, _ = truth.place("antenna left", *state(0.05 * k))
        assert abs(math.degrees(fix.latitude) - lat) < 1.5e-9
        assert abs(math.degrees(fix.longitude) - lon) < 1.5e-9


@pytest.mark.parametrize("start_ms", [0, 3, 40])
def test_epochs_lie_on_whole_periods_of_utc_and_bytes_come_after_their_latency(
    world: SimpleNamespace, start_ms: int
) -> None:
    machine = world.MACHINES["sun-a"]()
    start = datetime(2026, 2, 28, 23, 59, 59, 900_000 + start_ms * 1000, tzinfo=UTC)
    kit = world.kit_of(machine, world.exact(rate_hz=10), start_utc=start, start_ns=77 * MS)
    states = [(77 * MS + k * 10 * MS, machine.home, np.eye(4)) for k in range(60)]
    heard = world.hear(kit, states)
    utc_ns = int(start.timestamp()) * 1_000_000_000 + (900 + start_ms) * MS
    latency_ms = {"all/GN": 50, "all/UBX": 20}
    seen = 0
    for fix in heard.of(GnssFix):
        if fix.stamp.epoch_ns is None:
            continue
        seen += 1
        assert fix.stamp.epoch_ns % (100 * MS) == 0
        true_ns = fix.stamp.epoch_ns - utc_ns + 77 * MS
        assert fix.stamp.monotonic_ns - true_ns == latency_ms[fix.stamp.source] * MS
    assert seen > 15


def test_nothing_arrives_before_it_is_due(world: SimpleNamespace) -> None:
    machine = world.MACHINES["sun-a"]()
    kit = world.kit_of(machine, world.exact())
    kit.advance(0, machine.home, np.eye(4))
    assert {chunk.received_ns for chunk in kit.read(0)} == {0}  # the tilt sensor alone has no latency
    assert kit.read(9 * MS) == []
    assert [chunk.received_ns for chunk in kit.read(49 * MS)] == [10 * MS, 20 * MS]
    assert [chunk.received_ns for chunk in kit.read(50 * MS)] == [50 * MS]
    assert kit.read(10_000 * MS) == []


def test_a_machine_first_seen_late_has_no_epochs_before(world: SimpleNamespace) -> None:
    machine = world.MACHINES["rre20"]()
    kit = world.kit_of(machine, world.exact())
    heard = world.hear(kit, [(t_ms * MS, machine.home, np.eye(4)) for t_ms in (1003, 1050)])
    assert [chunk.received_ns // MS for chunk in heard.chunks if chunk.port == "gnss-left"] == [1070]
    links = [chunk.received_ns // MS for chunk in heard.chunks if chunk.port == "links"]
    assert links == [1020, 1030, 1040, 1050, 1060]


@pytest.mark.parametrize(("turns", "read"), [(0.0, 0.3), (1.0, 0.3), (0.5, 0.3 - math.pi), (-3.0, 0.3)])
def test_the_encoder_of_an_endless_joint_starts_again_at_half_a_turn(
    world: SimpleNamespace, turns: float, read: float
) -> None:
    machine = world.MACHINES["rre20"]()
    q = np.array(machine.home)
    q[0] = 0.3 + turns * 2.0 * math.pi
    (one,) = world.hear(world.kit_of(machine, world.exact()), [(0, q, np.eye(4))]).of(EncoderReading, "swing")
    assert one.value == pytest.approx(read, abs=1e-9)
