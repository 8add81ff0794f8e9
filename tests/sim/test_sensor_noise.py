"""Errors of simulated sensors: as large, as slow and as shared as their settings say, and each sensor's its own."""

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy import stats
from scipy.interpolate import PchipInterpolator

from workgauge.sim.sensors.faults import Fault, FaultKind
from workgauge.sim.sensors.randomness import BLOCK, GRID_NS, GaussMarkov, White, generator
from workgauge.sim.sensors.settings import FixNoise, HeadingSettings, LinkSettings, ReceiverSettings, SensorSettings
from workgauge.values.navigation import (
    AngularRate,
    EncoderReading,
    FixQuality,
    GnssError,
    GnssFix,
    GnssHeading,
    GnssVelocity,
    Inclination,
)

MS = 1_000_000
#: A right generator fails one of these checks once in so many seeds; the seeds are fixed.
RISK = 1e-4


def within_chi2(values, sigma: float) -> bool:
    """Return whether values of mean 0 may have that sigma."""
    n = np.size(values)
    low, high = stats.chi2.ppf([RISK / 2, 1 - RISK / 2], n)
    return low <= float(np.sum(np.square(values))) / sigma**2 <= high


def correlated_as(a, b, share: float) -> bool:
    """Return whether the correlation of two series may be `share` (Fisher's z)."""
    n = np.size(a)
    z = math.atanh(float(np.corrcoef(np.ravel(a), np.ravel(b))[0, 1])) - math.atanh(share)
    return abs(z) * math.sqrt(n - 3) < stats.norm.isf(RISK / 2)


def errors_m(world: SimpleNamespace, heard, port: str, machine) -> np.ndarray:
    """Return the errors (k, 3) east, north, up of a standing machine's fixes."""
    crs = world.frame_at().crs
    antenna = next(spec.antenna for spec in machine.positioning.receivers if spec.port == port)
    sensor = next(one for one in machine.sensors if one.name == antenna)
    true = machine.forward(machine.home).T_machine_links[sensor.link] @ sensor.T_link_sensor[:, 3]
    fixes = [one for one in heard.of(GnssFix, port) if one.sentence == "GGA"]
    e, n = crs.from_geodetic([one.latitude for one in fixes], [one.longitude for one in fixes])
    up = [one.height_msl_m for one in fixes]
    return np.column_stack([e, n, up]) - true[:3] - np.array(world.PLACES[3879])


QUIET = LinkSettings(rate_hz=1, gyros=False)


def long_run(world: SimpleNamespace, settings: SensorSettings, seconds: float, seed: int = 1):
    machine = world.MACHINES["rre20"]()
    kit = world.kit_of(machine, settings, seed=seed)
    return machine, world.hear(kit, world.standing(machine, round(seconds * 1000), 20))


@pytest.mark.parametrize("quality", [FixQuality.FIXED, FixQuality.FLOAT, FixQuality.DIFFERENTIAL, FixQuality.SINGLE])
def test_white_noise_has_the_files_sigma_by_quality(world: SimpleNamespace, quality: FixQuality) -> None:
    receivers = ReceiverSettings(rate_hz=50, quality=quality, sentences=("GGA",), noise=FixNoise(correlated=0.0))
    machine, heard = long_run(world, SensorSettings(receivers, links=QUIET), 8.0)
    file = machine.positioning.receivers[0].sigmas
    level, height = getattr(file, f"{quality.name.lower()}_m")
    for port in ("gnss-left", "gnss-right"):
        error = errors_m(world, heard, port, machine)
        assert len(error) == 401
        assert within_chi2(error[:, :2], level)
        assert within_chi2(error[:, 2], height)
        assert correlated_as(error[1:], error[:-1], 0.0)
        assert {fix.quality for fix in heard.of(GnssFix, port)} == {quality}


def test_the_shares_add_up_to_the_sigma_and_to_the_correlation_of_two_receivers(world: SimpleNamespace) -> None:
    """Slow noise made fast enough to see many independent values; corr = c m between receivers at equal sigmas."""
    noise = FixNoise({FixQuality.FIXED: (0.5, 0.5)}, correlated=0.8, common=0.75, correlation_s=0.0)
    receivers = ReceiverSettings(rate_hz=50, sentences=("GGA",), noise=noise)
    machine, heard = long_run(world, SensorSettings(receivers, links=QUIET), 20.0)
    left, right = (errors_m(world, heard, port, machine) for port in ("gnss-left", "gnss-right"))
    assert within_chi2(left, 0.5) and within_chi2(right, 0.5)
    assert correlated_as(left, right, 0.6)


@pytest.mark.parametrize(("common", "alike"), [(1.0, True), (0.0, False)])
def test_what_is_common_is_the_same_for_both_receivers(world: SimpleNamespace, common: float, alike: bool) -> None:
    noise = FixNoise({FixQuality.FIXED: (1.0, 1.0)}, correlated=1.0, common=common, correlation_s=5.0)
    receivers = ReceiverSettings(rate_hz=10, sentences=("GGA",), noise=noise)
    machine, heard = long_run(world, SensorSettings(receivers, links=QUIET), 3.0)
    left, right = (errors_m(world, heard, port, machine) for port in ("gnss-left", "gnss-right"))
    assert (np.abs(left - right).max() < 1e-3) == alike


@pytest.mark.parametrize("tau_s", [0.0, 0.05, 2.0])
def test_slow_noise_is_gauss_markov_of_that_time(tau_s: float) -> None:
    """Its innovations are white with the right variance, which no other decay gives; its first values are normal."""
    process = GaussMarkov(generator(3, "a"), tau_s, 0)
    values = np.array([process.at(k * GRID_NS) for k in range(40 * BLOCK)])
    a = math.exp(-GRID_NS * 1e-9 / tau_s) if tau_s else 0.0
    innovations = (values[1:] - a * values[:-1]) / math.sqrt(1 - a * a)
    assert within_chi2(innovations, 1.0)
    assert correlated_as(innovations[1:], innovations[:-1], 0.0)
    first = [GaussMarkov(generator(seed, "first"), tau_s, 5).at(5) for seed in range(400)]
    assert within_chi2(first, 1.0)
    assert stats.kstest(np.ravel(first), "norm").pvalue > RISK


def test_slow_noise_does_not_depend_on_how_often_it_is_asked() -> None:
    often, seldom = (GaussMarkov(generator(3, "a"), 1.0, 7) for _ in range(2))
    asked = {t: often.at(t) for t in range(7, 7 + 2000 * GRID_NS, GRID_NS // 2)}
    assert all((seldom.at(t) == asked[t]).all() for t in range(7, 7 + 2000 * GRID_NS, 13 * GRID_NS))
    with pytest.raises(ValueError, match="no longer known"):
        seldom.at(7)


def test_generators_of_different_names_have_nothing_in_common() -> None:
    names = [("a", "b"), ("ab", ""), ("a", "c"), ("b", "a")]
    drawn = [White(generator(1, *name), 3).draw() for name in names] + [White(generator(2, "a", "b"), 3).draw()]
    assert len({tuple(one) for one in drawn}) == len(drawn)
    assert (White(generator(1, "a", "b"), 3).draw() == drawn[0]).all()


def test_velocity_and_link_sensors_have_their_sigmas(world: SimpleNamespace) -> None:
    noise = FixNoise(velocity_m_s=0.05)
    receivers = ReceiverSettings(rate_hz=50, protocol="ubx", messages=("NAV-PVT",), noise=noise)
    links = LinkSettings(rate_hz=50, gyro_rad_s=0.004)
    machine, heard = long_run(world, SensorSettings(receivers, links=links), 6.0)
    climbs = [one.climb_m_s for one in heard.of(GnssVelocity, "gnss-left")]
    assert within_chi2(climbs, 0.05)
    speeds = np.array([one.speed_m_s for one in heard.of(GnssVelocity, "gnss-left")])
    assert stats.kstest(speeds / 0.05, "rayleigh").pvalue > RISK
    for spec in machine.positioning.joints:
        j = machine.joint_names.index(spec.joint)
        sigma = math.radians(spec.sigma_deg)
        if spec.kind == "encoder":
            read = [one.value - machine.home[j] for one in heard.of(EncoderReading, spec.sensor)]
            assert len(read) == 301 and within_chi2(read, sigma)
    for one, two in (("cabin imu", "boom imu"), ("boom imu", "stick imu")):
        a, b = (np.array([r.rate for r in heard.of(AngularRate, name)]) for name in (one, two))
        assert within_chi2(a, 0.004) and correlated_as(a, b, 0.0)


def test_an_inclinometers_error_tilts_alike_about_every_axis_whichever_way_it_lies(world: SimpleNamespace) -> None:
    """The bracket's stands on end at home, where roll and pitch are poor words for a tilt."""
    links = LinkSettings(rate_hz=50, gyros=False)
    machine, heard = long_run(world, SensorSettings(ReceiverSettings(rate_hz=1), links=links), 8.0)
    sensors = {sensor.name: sensor for sensor in machine.sensors}
    kin = machine.forward(machine.home)
    for name, sigma_deg in (("undercarriage tilt", 0.05), ("boom imu", 0.1), ("bracket imu", 0.1)):
        up = kin.T_machine_links[sensors[name].link][2, :3]
        seen = np.array(
            [
                (
                    -math.sin(one.pitch),
                    math.cos(one.pitch) * math.sin(one.roll),
                    math.cos(one.pitch) * math.cos(one.roll),
                )
                for one in heard.of(Inclination, name)
            ]
        )
        across = np.linalg.svd(up[None])[2][1:]
        tilts = (seen - up) @ across.T
        assert len(tilts) == 401
        for k in range(2):
            assert within_chi2(tilts[:, k], math.radians(sigma_deg))


@pytest.mark.parametrize(("fault", "factor"), [((), 1.0), ((Fault(FaultKind.FLOAT),), 10.0)])
def test_a_moving_base_has_the_files_sigma_and_says_so(world: SimpleNamespace, fault, factor: float) -> None:
    """Ten times as large without fixed ambiguities; pitch twice as uncertain as heading."""
    machine = world.MACHINES["moving base"]()
    settings = SensorSettings(
        ReceiverSettings(rate_hz=1),
        heading=HeadingSettings(rate_hz=50, correlated=0.0, protocol="both"),
        links=QUIET,
        faults=fault,
    )
    heard = world.hear(world.kit_of(machine, settings), world.standing(machine, 8000, 20))
    exact = world.hear(world.kit_of(machine, world.exact(rate_hz=1, links=QUIET)), world.standing(machine, 0, 20))
    (true,) = exact.of(GnssHeading)
    sigma = factor * math.radians(machine.positioning.heading.sigma_deg)
    for sentence in ("PTNL,AVR", "NAV-RELPOSNED"):
        read = [one for one in heard.of(GnssHeading) if one.sentence == sentence]
        assert len(read) == 401
        assert within_chi2([math.remainder(one.heading - true.heading, 2 * math.pi) for one in read], sigma)
        assert within_chi2([one.pitch - true.pitch for one in read], 2.0 * sigma)
        assert {one.quality for one in read} == {FixQuality.FLOAT if fault else FixQuality.FIXED}
    assert read[0].sigma == pytest.approx(sigma, rel=1e-3)


def test_a_wire_encoders_errors_are_of_its_stroke_and_of_its_calibration(world: SimpleNamespace) -> None:
    """In the joint they add up: the stroke's times the curve's slope, and the joint's own."""
    machine = world.MACHINES["brokk5"]()
    section = machine.positioning
    j, wire = next((k, one) for k, one in enumerate(section.joints) if one.kind == "wire_encoder")
    curve = PchipInterpolator(wire.calibration.stroke_m, np.radians(wire.calibration.position_deg))
    for stroke_m, joint_deg in ((0.001, None), (None, 0.4), (0.001, 0.4), (None, None)):
        spec = wire.model_copy(update={"sigma_m": stroke_m, "sigma_deg": joint_deg})
        joints = tuple(spec if k == j else one for k, one in enumerate(section.joints))
        changed = replace(machine, positioning=section.model_copy(update={"joints": joints}))
        settings = SensorSettings(ReceiverSettings(rate_hz=1), links=LinkSettings(rate_hz=50, gyros=False))
        heard = world.hear(world.kit_of(changed, settings), world.standing(changed, 6000, 20))
        strokes = np.array([one.value for one in heard.of(EncoderReading, wire.sensor)])
        at = float(np.mean(strokes))
        joint = math.radians(joint_deg if joint_deg is not None else 0.0 if stroke_m else 0.1)
        sigma = math.hypot((stroke_m or 0.0) * float(curve(at, 1)), joint)
        assert len(strokes) == 301
        assert within_chi2(curve(strokes) - machine.home[machine.joint_names.index(wire.joint)], sigma)


@pytest.mark.parametrize("stated", [0.5, 1.0])
def test_what_a_receiver_states_of_its_error(world: SimpleNamespace, stated: float) -> None:
    receivers = ReceiverSettings(protocol="both", messages=("NAV-COV", "NAV-PVT"), stated=stated)
    machine, heard = long_run(world, SensorSettings(receivers, links=QUIET), 0.2)
    level, height = machine.positioning.receivers[0].sigmas.fixed_m
    said = heard.of(GnssError, "gnss-left")
    assert {one.sentence for one in said} >= {"GST", "NAV-COV"}
    for one in said:
        sigmas = np.sqrt(np.diag(one.covariance))
        assert sigmas == pytest.approx([stated * level, stated * level, stated * height], abs=6e-4)


def bytes_by_port(world: SimpleNamespace, settings: SensorSettings, seed: int = 1) -> dict[str, bytes]:
    machine = world.MACHINES["rre20"]()
    heard = world.hear(world.kit_of(machine, settings, seed=seed), world.standing(machine, 1500))
    ports = {chunk.port for chunk in heard.chunks}
    return {port: b"".join(chunk.data for chunk in heard.chunks if chunk.port == port) for port in ports}


def test_the_same_seed_gives_the_same_bytes_and_another_seed_others(world: SimpleNamespace) -> None:
    settings = SensorSettings(ReceiverSettings(protocol="both", jitter_s=0.002), links=LinkSettings(jitter_s=0.001))
    first = bytes_by_port(world, settings)
    assert first == bytes_by_port(world, settings)
    other = bytes_by_port(world, settings, seed=2)
    assert all(first[port] != other[port] for port in first)


@pytest.mark.parametrize(
    "changed",
    [
        ReceiverSettings(rate_hz=10),
        ReceiverSettings(protocol="both", jitter_s=0.01),
        ReceiverSettings(quality=FixQuality.SINGLE),
        ReceiverSettings(noise=FixNoise(scale=0.0)),
        ReceiverSettings(noise=FixNoise(correlation_s=1.0, correlated=1.0, common=0.0, velocity_m_s=1.0)),
    ],
)
def test_one_receivers_settings_do_not_shift_anothers_numbers(world: SimpleNamespace, changed) -> None:
    plain = bytes_by_port(world, SensorSettings())
    other = bytes_by_port(world, SensorSettings(each={"left receiver": changed}))
    assert other["gnss-left"] != plain["gnss-left"]
    assert other["gnss-right"] == plain["gnss-right"]
    assert other["links"] == plain["links"]


def test_link_settings_and_faults_do_not_shift_the_receivers_numbers(world: SimpleNamespace) -> None:
    plain = bytes_by_port(world, SensorSettings())
    silent = Fault(FaultKind.SILENCE, sensor="all")
    for links, faults in ((LinkSettings(rate_hz=50, scale=3.0, gyros=False), ()), (LinkSettings(), (silent,))):
        other = bytes_by_port(world, SensorSettings(links=links, faults=faults))
        assert {port: other[port] for port in ("gnss-left", "gnss-right")} == {
            port: plain[port] for port in ("gnss-left", "gnss-right")
        }


def test_jitter_only_delays_and_keeps_the_order(world: SimpleNamespace) -> None:
    receivers = ReceiverSettings(rate_hz=50, jitter_s=0.01, noise=FixNoise(scale=0.0))
    _, heard = long_run(world, SensorSettings(receivers, links=QUIET), 10.0)
    fixes = [one for one in heard.of(GnssFix, "gnss-left") if one.sentence == "GGA"]
    first = fixes[0].stamp.epoch_ns
    late_s = np.array([one.stamp.monotonic_ns - (one.stamp.epoch_ns - first) for one in fixes]) * 1e-9 - 0.02
    assert late_s.min() >= -1e-12
    arrivals = [one.stamp.monotonic_ns for one in fixes]
    assert arrivals == sorted(arrivals)
    # queueing only adds to the exponential delay of mean 10 ms
    assert 0.009 < late_s.mean() < 0.02
