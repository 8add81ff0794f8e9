"""The locator on real bytes of simulated sensors: standing, swinging, travelling, on rails and off, in trouble."""

import copy
import dataclasses
import math
import re
from collections.abc import Callable
from functools import lru_cache
from importlib import resources
from pathlib import Path

import numpy as np
import pytest
import yaml

from workgauge.gauge.rulebook import load_rule_book
from workgauge.geodesy.frame import SiteFrame
from workgauge.machine.load import load_machine, machine_from
from workgauge.machine.model import MachineModel
from workgauge.positioning.locate import Locator
from workgauge.positioning.memory import Located, LocatorMemory
from workgauge.positioning.track import RailTrack
from workgauge.rehearse.shipped import shipped_site_files
from workgauge.sim.sensors.faults import Fault, FaultKind
from workgauge.sim.sensors.kit import SensorKit
from workgauge.sim.sensors.settings import FixNoise, LinkSettings, ReceiverSettings, SensorSettings
from workgauge.site.model import SiteModel
from workgauge.site.read import read_site
from workgauge.values.arrays import Floats
from workgauge.values.health import HealthState
from workgauge.values.navigation import FixQuality, Measurement
from workgauge.values.reasons import ReasonCode
from workgauge.values.transforms import rotation
from workgauge.wire.stream import StreamDecoder

from .kit import pose_error

TICK = 10_000_000
START_M = 500.0


@lru_cache
def site() -> SiteModel:
    return read_site(list(shipped_site_files("double_track")))


@lru_cache
def track() -> RailTrack:
    return RailTrack.of(site(), load_rule_book("finland"), site().alignments[0])


@lru_cache
def frame() -> SiteFrame:
    e, n, z = track().poses(np.array([START_M]))[0][0][:3, 3].tolist()
    return site().frame((e, n, z))


@lru_cache
def rre20() -> MachineModel:
    return load_machine("rre20")


@lru_cache
def moving_base() -> MachineModel:
    """One receiver with a moving base's heading, everything on one port, the inclinometer on the cab."""
    path = Path(str(resources.files("workgauge"))) / "shipped" / "machines" / "rre20.yaml"
    description = copy.deepcopy(yaml.safe_load(path.read_text()))
    section = description["positioning"]
    section["receivers"] = [{"name": "base", "antenna": "antenna left", "port": "gnss"}]
    section["heading"] = {"kind": "moving_base", "master": "antenna left", "rover": "antenna right", "port": "gnss"}
    section["tilt"] = {"sensor": "cabin imu"}
    return machine_from(description)


def truth(speed: float, swing: float) -> Callable[[float], tuple[Floats, Floats]]:
    def state(t: float) -> tuple[Floats, Floats]:
        T = np.array(track().poses(np.array([START_M + speed * t]))[0][0])
        T[:3, 3] -= frame().origin
        q = np.array(rre20().home)
        q[0] = math.remainder(swing * t, 2 * math.pi)
        q[1] += 0.1 * math.sin(t)
        return q, T

    return state


@dataclasses.dataclass
class Run:
    """Every tick of a drive: time, truth, what was located."""

    times: list[float]
    truths: list[tuple[Floats, Floats]]
    located: list[Located]
    memory: LocatorMemory
    batches: list[tuple[int, list[Measurement]]]

    def errors(self, after_s: float = 1.0) -> tuple[Floats, Floats]:
        """(k, 6) errors of the poses handed on and their sigmas."""
        found = [
            (pose_error(T, one.pose.T_site_machine), np.sqrt(np.diag(one.pose.covariance)))
            for t, (_, T), one in zip(self.times, self.truths, self.located, strict=True)
            if one.pose is not None and t >= after_s
        ]
        errors, sigmas = zip(*found, strict=True)
        return np.array(errors), np.array(sigmas)


def drive(
    seconds: float,
    state: Callable[[float], tuple[Floats, Floats]],
    settings: SensorSettings,
    *,
    on: RailTrack | None = None,
    machine: MachineModel | None = None,
    seed: int = 3,
) -> Run:
    machine = machine or rre20()
    crs = site().crs
    assert crs is not None
    locator = Locator(machine, "m", crs, frame(), track=on)
    kit = SensorKit(machine, crs, frame(), settings, seed=seed, machine_id="m")
    decoders: dict[str, StreamDecoder] = {}
    run = Run([], [], [], locator.start(), [])
    for k in range(round(seconds * 100)):
        now, t = k * TICK, k * 0.01
        q, T = state(t)
        kit.advance(now, q, T)
        measured: list[Measurement] = []
        for chunk in kit.read(now):
            decoder = decoders.setdefault(chunk.port, StreamDecoder(chunk.port, "m"))
            measured += decoder.feed(chunk)
        located, run.memory = locator.step(measured, now, run.memory)
        run.times.append(t)
        run.truths.append((q, T))
        run.located.append(located)
        run.batches.append((now, measured))
    return run


def settings(
    quality: FixQuality = FixQuality.FIXED, scale: float = 1.0, faults: tuple[Fault, ...] = (), **receiver: object
) -> SensorSettings:
    mine = ReceiverSettings(quality=quality, noise=FixNoise(scale=scale), **receiver)  # type: ignore[arg-type]
    return SensorSettings(receivers=mine, links=LinkSettings(scale=scale), faults=faults)


@pytest.mark.parametrize("rails", [False, True])
@pytest.mark.parametrize(("speed", "swing"), [(0.0, 0.9), (2.0, -0.9)])
def test_almost_without_noise_the_machine_is_where_it_is(rails: bool, speed: float, swing: float) -> None:
    """A swinging cab moves no undercarriage; a travelling one is where it is now, not where it was."""
    on = track() if rails else None
    run = drive(1.5, truth(speed, swing), settings(scale=1e-3), on=on)
    errors, _ = run.errors(0.8)
    assert len(errors) > 60
    assert np.abs(errors[:, :3]).max() < 2e-3 and np.abs(errors[:, 3:]).max() < 5e-4
    for (q, _), one in zip(run.truths[80:], run.located[80:], strict=True):
        assert one.posture is not None
        assert np.abs(np.remainder(one.posture.q - q + np.pi, 2 * np.pi) - np.pi).max() < 1e-3
    assert run.memory.motion.speed_m_s == pytest.approx(speed, abs=0.02)


@pytest.mark.parametrize("rails", [False, True])
@pytest.mark.parametrize("quality", [FixQuality.FIXED, FixQuality.FLOAT])
@pytest.mark.parametrize("protocol", ["nmea", "ubx"])
def test_errors_are_as_large_as_claimed(rails: bool, quality: FixQuality, protocol: str) -> None:
    run = drive(2.5, truth(1.0, 0.5), settings(quality, protocol=protocol), on=track() if rails else None)
    errors, sigmas = run.errors()
    assert len(errors) > 140
    assert (np.abs(errors) / sigmas).max() < 5.33
    expected = HealthState.FIXED if quality is FixQuality.FIXED else HealthState.FLOAT
    assert run.located[-1].health.state is expected
    q, _ = run.truths[-1]
    posture = run.located[-1].posture
    assert posture is not None and posture.covariance is not None
    off = np.remainder(posture.q - q + np.pi, 2 * np.pi) - np.pi
    assert (np.abs(off) < 5.33 * posture.sigma).all()
    np.testing.assert_allclose(np.diag(posture.covariance), posture.sigma**2, rtol=1e-9)


@pytest.mark.parametrize("rails", [False, True])
def test_one_antenna_a_moving_base_and_an_inclinometer_on_the_cab(rails: bool) -> None:
    run = drive(2.5, truth(1.0, 0.4), settings(), on=track() if rails else None, machine=moving_base())
    errors, sigmas = run.errors()
    assert len(errors) > 100 and (np.abs(errors) / sigmas).max() < 5.33
    assert sigmas[:, 0].max() < 0.05


@pytest.mark.parametrize("quality", [FixQuality.FLOAT, FixQuality.DIFFERENTIAL])
def test_rails_halve_what_is_unsure_across(quality: FixQuality) -> None:
    def across(run: Run) -> float:
        newest = run.memory.solved
        assert newest is not None
        left = newest.T[:3, 1]
        return math.sqrt(float(left @ newest.covariance[:3, :3] @ left))

    free, led = (drive(0.4, truth(0.0, 0.0), settings(quality), on=on) for on in (None, track()))
    assert across(led) < 0.5 * across(free)
    assert across(led) >= math.sqrt(0.01**2 + 0.01**2 / 3) - 1e-9


def test_no_pose_while_it_may_not_be_used_and_the_reasons_say_why() -> None:
    run = drive(0.7, truth(0.0, 0.0), settings())
    for one in run.located:
        assert (one.pose is None) == (not one.health.state.usable)
        assert one.health.state is not HealthState.STOP or one.health.reasons
    assert run.located[0].pose is None and run.located[-1].pose is not None
    last = run.located[-1]
    assert last.pose is not None and last.pose.stamp.monotonic_ns == run.batches[-1][0]
    assert last.pose.stamp.epoch_ns is not None and last.fix is not None and len(last.fix.antennas) == 2


def test_the_chassis_is_held_and_the_arm_is_live() -> None:
    silence = Fault(FaultKind.SILENCE, from_ns=1_000_000_000)
    run = drive(4.0, truth(0.0, 0.4), settings(faults=(silence,)))
    states = [one.health.state for one in run.located]
    assert states.index(HealthState.DEAD_RECKONING) < states.index(HealthState.CHASSIS_FROZEN)
    frozen = [one for one in run.located if one.health.state is HealthState.CHASSIS_FROZEN]
    assert len(frozen) > 50
    first, last = frozen[0], frozen[-1]
    assert first.pose is not None and last.pose is not None
    np.testing.assert_array_equal(first.pose.T_site_machine, last.pose.T_site_machine)
    np.testing.assert_array_equal(first.pose.covariance, last.pose.covariance)
    assert last.posture is not None
    assert abs(math.remainder(last.posture.q[0] - run.truths[-1][0][0], 2 * math.pi)) < 0.01
    reckoned = [one for one in run.located if one.health.state is HealthState.DEAD_RECKONING]
    sigmas = [np.trace(one.pose.covariance[:3, :3]) for one in reckoned if one.pose is not None]
    assert len(sigmas) > 50 and (np.diff(sigmas) >= 0).all()


def test_antennas_changed_over_are_told() -> None:
    for on in (None, track()):
        fault = Fault(FaultKind.SWAPPED, from_ns=1_000_000_000)
        run = drive(1.3, truth(0.0, 0.0), settings(faults=(fault,)), on=on)
        assert run.located[-1].health.state is HealthState.STOP and run.located[-1].pose is None
        assert ReasonCode.HEADING_DISAGREES in {reason.code for reason in run.located[-1].health.reasons}


@pytest.mark.parametrize(
    ("shift", "turn_deg", "words"),
    [
        ((0.0, 3.0, 0.0), (0.0, 0.0, 0.0), r"receivers lie [23]\.\d\d m left of the track"),
        ((0.0, -0.5, 0.0), (0.0, 0.0, 0.0), r"receivers lie 0\.[45]\d m right of the track"),
        ((0.0, 0.0, 5.0), (0.0, 0.0, 0.0), r"receivers lie [45]\.\d\d m above the track"),
        ((0.0, 0.0, 0.0), (2.0, 0.0, 0.0), r"the inclinometer leans [12]\.\d° off the track's cant"),
        ((0.0, 0.0, 0.0), (0.0, 1.0, 0.0), r"the inclinometer leans [01]\.\d° off the track's gradient"),
    ],
)
def test_sensors_that_contradict_the_track_stop_the_machine(
    shift: tuple[float, float, float], turn_deg: tuple[float, float, float], words: str
) -> None:
    """The machine stands beside or above the track it is told to be on, or leans otherwise."""

    def state(t: float) -> tuple[Floats, Floats]:
        q, T = truth(0.0, 0.0)(t)
        T = np.array(T)
        T[:3, 3] += T[:3, :3] @ shift
        T[:3, :3] = T[:3, :3] @ rotation(np.radians(turn_deg))
        return q, T

    run = drive(1.2, state, settings(), on=track())
    last = run.located[-1]
    assert last.fix is not None and re.search(words, last.fix.off_track), last.fix
    assert last.health.state is HealthState.STOP and last.pose is None
    assert last.health.reasons[0].code is ReasonCode.SENSOR_DISAGREES
    assert last.fix.off_track in last.health.reasons[0].text


def test_a_receiver_that_was_never_heard_is_named() -> None:
    fault = Fault(FaultKind.SILENCE, from_ns=0, receiver="right receiver")
    run = drive(0.5, truth(0.0, 0.0), settings(faults=(fault,)))
    texts = [reason.text for reason in run.located[-1].health.reasons]
    assert texts[0] == "no fix heard of right receiver, port gnss-right" and not any("left" in text for text in texts)


def test_a_silent_link_sensor_is_named_and_its_posture_grows_old() -> None:
    fault = Fault(FaultKind.SILENCE, from_ns=800_000_000, sensor="stick imu")
    run = drive(1.2, truth(0.0, 0.0), settings(faults=(fault,)))
    last = run.located[-1]
    assert last.health.state is HealthState.STOP
    assert any(r.code is ReasonCode.SENSOR_STALE and "stick imu" in r.text for r in last.health.reasons)
    assert last.posture is not None and last.posture.stamp.age_s(run.batches[-1][0]) > 0.2


def test_a_joint_that_jumps_is_named_until_it_is_back() -> None:
    fault = Fault(FaultKind.SENSOR_JUMP, 800_000_000, 1_000_000_000, sensor="swing encoder", offset=0.5)
    run = drive(1.8, truth(0.0, 0.0), settings(faults=(fault,)))
    named = [any(r.joint == "swing" for r in one.health.reasons) for one in run.located]
    assert not any(named[:80]) and all(named[84:100]) and not any(named[104:])
    assert run.located[-1].health.state is HealthState.FIXED


def test_the_same_measurements_locate_the_same_bit_for_bit() -> None:
    run = drive(0.8, truth(1.0, 0.3), settings(), on=track())
    crs = site().crs
    assert crs is not None
    locator = Locator(rre20(), "m", crs, frame(), track=track())
    for _ in range(2):
        memory = locator.start()
        for now, measured in run.batches:
            located, memory = locator.step(measured, now, memory)
        one, two = located.pose, run.located[-1].pose
        assert one is not None and two is not None
        assert one.T_site_machine.tobytes() == two.T_site_machine.tobytes()
        assert one.covariance.tobytes() == two.covariance.tobytes()


def test_a_locator_can_be_put_on_another_track_and_leaves_others_alone() -> None:
    crs = site().crs
    assert crs is not None
    free = Locator(rre20(), "m", crs, frame())
    led = free.on(site().alignments[0])
    assert free.track is None and led.track is not None and led.track.alignment is site().alignments[0]
    assert led.on(None).track is None and led.on(led.track) is led
    run = drive(0.7, truth(0.0, 0.0), settings())
    other = [m for _, batch in run.batches for m in batch]
    foreign = [dataclasses.replace(m, stamp=dataclasses.replace(m.stamp, machine_id="other")) for m in other]
    located, memory = free.step(foreign, TICK, free.start())
    assert located.pose is None and located.posture is None
    assert all(not samples for samples in memory.samples) and all(not one.epochs for one in memory.heard)


def test_a_machine_without_a_section_cannot_be_located() -> None:
    crs = site().crs
    assert crs is not None
    with pytest.raises(ValueError, match="no positioning section"):
        Locator(load_machine("brokk5"), "m", crs, frame())
