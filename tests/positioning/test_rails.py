"""A machine on rails: exact without noise, weighted with it, never surer than the track."""

import math
from functools import lru_cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from workgauge.gauge.rulebook import load_rule_book
from workgauge.gauge.rules import RuleBook
from workgauge.machine.load import load_machine
from workgauge.machine.positioning import RailSpec
from workgauge.positioning.antennas import baseline, two_antenna_pose
from workgauge.positioning.rails import Azimuth, RailSolution, on_rails, track_covariance
from workgauge.positioning.track import RailTrack
from workgauge.rehearse.shipped import shipped_site_files
from workgauge.rehearse.start import Rails
from workgauge.site.model import SiteModel
from workgauge.site.read import read_site
from workgauge.values.arrays import Floats

from .kit import Exact, moved, pose_error, random_q

SEEDS = st.integers(0, 2**32 - 1)
SPEC = RailSpec()
MACHINE = load_machine("rre20")


@lru_cache
def site() -> tuple[SiteModel, RuleBook]:
    return read_site(list(shipped_site_files("double_track"))), load_rule_book("finland")


@lru_cache
def track(index: int) -> RailTrack:
    model, rules = site()
    return RailTrack.of(model, rules, model.alignments[index])


def place(which: RailTrack, s: float, forward: bool) -> tuple[Floats, Floats]:
    """Pose in a local frame, and its origin."""
    T = np.array(which.poses(np.array([s]), forward)[0][0])
    origin = np.round(T[:3, 3], -2)
    T[:3, 3] -= origin
    return T, origin


def solve(
    exact: Exact,
    which: RailTrack,
    origin: Floats,
    start: float,
    forward: bool,
    sigma: float,
    *,
    kind: str = "two",
    noise: np.random.Generator | None = None,
    spec: RailSpec = SPEC,
    joint_sigma: float = 1e-4,
) -> RailSolution | None:
    def error(scale: float, *shape: int) -> Floats:
        return np.zeros(shape) if noise is None else scale * noise.normal(size=shape)

    C = np.diag([1, 1, 2.0]) ** 2 * sigma**2
    q = exact.q + error(joint_sigma, MACHINE.n)
    kin = MACHINE.forward(q)
    first = exact.antenna("antenna right", C, error(sigma, 3) * [1, 1, 2])
    second = exact.antenna("antenna left", C, error(sigma, 3) * [1, 1, 2])
    tilt = exact.tilt("undercarriage tilt", 1e-3, tuple(error(1e-3, 2).tolist()))  # type: ignore[arg-type]
    Q = np.eye(MACHINE.n) * joint_sigma**2
    azimuth, antennas = None, (first, second)
    if kind == "one":
        sensors = [exact.sensors[name] for name in ("antenna right", "antenna left")]
        arm, gain = baseline(MACHINE, kin, *((one.link, one.T_link_sensor[:3, 3]) for one in sensors))
        true, _ = baseline(MACHINE, exact.kin, *((one.link, one.T_link_sensor[:3, 3]) for one in sensors))
        way = exact.T[:3, :3] @ true
        azimuth = Azimuth(math.atan2(way[1], way[0]) + float(error(5e-3, 1)[0]), 5e-3, arm, gain)
        antennas = (first,)
    return on_rails(MACHINE, kin, which, spec, origin, antennas, azimuth, tilt, Q, start=start, forward=forward)


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 1), st.floats(0, 1), st.booleans())
def test_rails_lie_where_the_simulated_machine_stands(index: int, share: float, forward: bool) -> None:
    model, rules = site()
    which = track(index)
    s = share * which.length
    stood = Rails(model, rules, which.alignment, MACHINE).pose(s, forward)
    np.testing.assert_allclose(which.poses(np.array([s]), forward)[0][0], stood, atol=1e-9)


@settings(max_examples=80, deadline=None)
@given(st.integers(0, 1), st.floats(0, 1), st.floats(-3, 3), st.floats(-5, 5))
def test_the_nearest_place_from_a_hint_is_the_nearest_place(
    index: int, share: float, left: float, hint: float
) -> None:
    which = track(index)
    s = share * which.length
    T = which.poses(np.array([s]))[0][0]
    e, n = (T[:3, 3] + left * T[:3, 1])[:2]
    whole = which.nearest(e, n)
    assert which.nearest(e, n, s + hint) == pytest.approx(whole, abs=2e-4)


@settings(max_examples=80, deadline=None)
@given(SEEDS, st.sampled_from(["two", "one"]), st.booleans())
def test_the_pose_comes_back_exactly(seed: int, kind: str, forward: bool) -> None:
    rng = np.random.default_rng(seed)
    which = track(int(rng.integers(2)))
    s = float(rng.uniform(1, which.length - 1))
    T, origin = place(which, s, forward)
    exact = Exact(MACHINE, T, random_q(rng, MACHINE))
    found = solve(exact, which, origin, which.nearest(*(T[:2, 3] + origin[:2])), forward, 0.015, kind=kind)
    assert found is not None
    np.testing.assert_allclose(found.pose.T_site_machine, T, atol=1e-9)
    assert found.across.sigmas < 1e-6 and found.misfit_sigmas < 1e-3
    # from a start that is metres off, by linearising anew
    off = solve(exact, which, origin, min(max(s + rng.uniform(-3, 3), 0), which.length), forward, 0.015, kind=kind)
    assert off is not None
    np.testing.assert_allclose(off.pose.T_site_machine, T, atol=1e-4)


@pytest.mark.parametrize("kind", ["two", "one"])
@pytest.mark.parametrize("sigma", [0.015, 0.3, 0.7])
def test_weights_are_right_and_the_track_is_the_floor(kind: str, sigma: float) -> None:
    """Truth drawn round the track, receivers round it: the posterior is calibrated, what is handed on wider."""
    rng, which, s = np.random.default_rng(9), track(0), 700.0
    T_track, origin = place(which, s, True)
    state = which.alignment.at([s])
    F = track_covariance(SPEC, which.rotation.base, float(state.curvature[0]))
    draws, squares, sigmas, inside = 600, [], [], 0
    B = np.zeros((6, 5))
    B[:3, 0], B[:3, 1] = T_track[:3, 1], T_track[:3, 2]
    B[3:, 2], B[3:, 3], B[3:, 4] = T_track[:3, 0], T_track[:3, 1], T_track[:3, 2]
    for _ in range(draws):
        T = moved(T_track, B @ (np.sqrt(np.diag(F)) * rng.normal(size=5)))
        exact = Exact(MACHINE, T, np.array(MACHINE.home))
        found = solve(exact, which, origin, s, True, sigma, kind=kind, noise=rng)
        assert found is not None
        xi = pose_error(T, found.pose.T_site_machine)
        axes = T_track[:3, :3]
        error = np.concatenate([axes.T @ xi[:3], axes.T @ xi[3:]])
        squares.append(float(error @ np.linalg.solve(found.posterior, error)))
        assert found.above is not None and found.pitch is not None
        sigmas.append((found.across.sigmas, found.above.sigmas, found.roll.sigmas, found.pitch.sigmas))
        assert np.linalg.eigvalsh(found.covariance - found.posterior).min() > -1e-12
        np.testing.assert_allclose(found.covariance[1:, 1:], F, rtol=1e-6)
        inside += error @ np.linalg.solve(found.covariance, error) < 12.59  # 95 % of chi squared of six
    assert abs(np.mean(squares) - 6.0) < 5 * math.sqrt(12 / draws)
    assert inside >= 0.95 * draws - 3 * math.sqrt(0.95 * 0.05 * draws)
    assert (np.abs(np.mean(np.square(sigmas), axis=0) - 1.0) < 5 * math.sqrt(2 / draws)).all()


def across(found: RailSolution | None) -> float:
    assert found is not None
    left = found.pose.T_site_machine[:3, 1]
    return math.sqrt(float(left @ found.pose.covariance[:3, :3] @ left))


@pytest.mark.parametrize(
    ("quality", "sigma", "least"), [("fixed", 0.015, 0.9), ("float", 0.3, 2.0), ("dgnss", 0.7, 2.0)]
)
def test_rails_at_least_halve_what_is_unsure_across(quality: str, sigma: float, least: float) -> None:
    which = track(0)
    for s in (100.0, 500.0, 700.0):
        T, origin = place(which, s, True)
        exact = Exact(MACHINE, T, np.array(MACHINE.home))
        C = np.diag([1, 1, 2.0]) ** 2 * sigma**2
        free = two_antenna_pose(
            MACHINE,
            exact.kin,
            exact.antenna("antenna right", C),
            exact.antenna("antenna left", C),
            exact.tilt("undercarriage tilt", 1e-3),
            np.eye(6) * 1e-8,
        )
        assert free is not None
        left = T[:3, 1]
        off = math.sqrt(float(left @ free.covariance[:3, :3] @ left))
        assert off >= least * across(solve(exact, which, origin, s, True, sigma)), quality


def test_receivers_beside_the_track_are_told() -> None:
    rng, which, s = np.random.default_rng(2), track(0), 400.0
    T, origin = place(which, s, False)
    for shift, sigma in ((0.2, 0.015), (-3.0, 0.3), (4.5, 0.7)):
        beside = np.array(T)
        beside[:3, 3] += shift * -T[:3, 1]  # the track's left is the right of a machine facing backward
        found = solve(Exact(MACHINE, beside, random_q(rng, MACHINE)), which, origin, s, False, sigma)
        assert found is not None
        assert found.across.sigmas > 5.0 and found.across.amount == pytest.approx(shift, rel=0.35)
        assert found.misfit_sigmas > 4.0


def test_nothing_is_found_beyond_the_ends() -> None:
    which = track(0)
    T, origin = place(which, which.length, True)
    T[:3, 3] += 30.0 * T[:3, 0]
    exact = Exact(MACHINE, T, np.array(MACHINE.home))
    assert solve(exact, which, origin, which.length, True, 0.015) is None


def test_a_wider_play_or_curve_is_less_sure() -> None:
    plain, loose = track_covariance(SPEC, 1.5), track_covariance(RailSpec(flange_play_m=0.03), 1.5)
    assert loose[0, 0] > plain[0, 0] and loose[4, 4] > plain[4, 4]
    assert track_covariance(SPEC, 1.5, 1 / 200)[0, 0] == pytest.approx(plain[0, 0] + (16 / 1600) ** 2)
    assert plain[0, 0] >= SPEC.as_built_sigma_m**2 + SPEC.flange_play_m**2 / 3
