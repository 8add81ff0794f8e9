"""Measuring up a tool: the tip is found from touches, with a tolerance that holds, and poor postures are refused."""

import math
from importlib import resources

import numpy as np
import pytest
import yaml
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy import stats

from workgauge.machine.load import load_machine, machine_from
from workgauge.machine.measure_up import MeasuredUp, Touch, attachment_entry, measure_up, sensor_sigmas
from workgauge.machine.model import MachineModel
from workgauge.values.arrays import Floats, frozen
from workgauge.values.errors import MachineError

TIP = np.array([0.12, -0.03, 1.71])
SIGMA_M = 0.005
RRE20 = yaml.safe_load((resources.files("workgauge") / "shipped" / "machines" / "rre20.yaml").read_text())


@pytest.fixture(scope="module")
def machine() -> MachineModel:
    return load_machine("rre20")


def postures(machine: MachineModel, rng: np.random.Generator, many: int) -> Floats:
    low, high = np.maximum(machine.sample_min, -1.2), np.minimum(machine.sample_max, 1.2)
    return rng.uniform(np.minimum(low, high), np.maximum(low, high), (many, machine.n))


def tip_at(machine: MachineModel, q: Floats, tip: Floats = TIP) -> Floats:
    T = machine.forward(q).T_machine_links[-1]
    return T[:3, :3] @ tip + T[:3, 3]


def surveyed(
    machine: MachineModel, seed: int, many: int, sigma_m: float, joints: Floats | None = None
) -> list[Touch]:
    """Return touches whose place a total station measured, joints as the sensors read them."""
    rng = np.random.default_rng(seed)
    out = []
    for q in postures(machine, rng, many):
        read = q if joints is None else q + joints * rng.standard_normal(machine.n)
        out.append(Touch(frozen(read), frozen(tip_at(machine, q) + sigma_m * rng.standard_normal(3))))
    return out


def on_one_point(machine: MachineModel, seed: int, many: int, noise_m: float, joints: list[int]) -> list[Touch]:
    """Return touches of one same point: each starts somewhere else and is brought there by Newton's method."""
    rng = np.random.default_rng(seed)
    q0 = np.array(machine.home)
    target = tip_at(machine, q0)
    out: list[Touch] = []
    while len(out) < many:
        q = q0.copy()
        q[joints] += rng.uniform(-0.5, 0.5, len(joints))
        goal = target + noise_m * rng.standard_normal(3)
        for _ in range(60):
            kin = machine.forward(q)
            miss = goal - tip_at(machine, q)
            J = machine.point_jacobians(kin, [machine.tool_link], [tip_at(machine, q)])[0][:, joints]
            q[joints] += np.linalg.lstsq(J, miss, rcond=1e-6)[0]
        if np.linalg.norm(goal - tip_at(machine, q)) < 1e-9:
            out.append(Touch(frozen(q)))
    return out


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**31), st.integers(3, 8), st.tuples(*[st.floats(-1.0, 2.0)] * 3))
def test_without_noise_the_tip_is_found_to_numerical_precision(
    machine: MachineModel, seed: int, many: int, tip: tuple[float, float, float]
) -> None:
    rng = np.random.default_rng(seed)
    touches = [Touch(frozen(q), frozen(tip_at(machine, q, np.array(tip)))) for q in postures(machine, rng, many)]
    turns = [machine.forward(touch.q).T_machine_links[-1, :3, :3] for touch in touches]
    assume(min(np.trace(one.T @ other) for one in turns for other in turns) < 1 + 2 * math.cos(math.radians(11)))
    measured = measure_up(machine, touches, SIGMA_M)
    assert measured.position == pytest.approx(np.array(tip), abs=1e-9)
    assert measured.rms_m < 1e-9 and measured.redundancy == 3 * many - 3
    assert measured.tolerance_m == pytest.approx(SIGMA_M / math.sqrt(many), rel=1e-6)


def test_one_point_touched_in_many_postures_gives_tip_and_point(machine: MachineModel) -> None:
    touches = on_one_point(machine, 5, 8, 0.0, list(range(machine.n)))
    measured = measure_up(machine, touches, SIGMA_M)
    assert measured.position == pytest.approx(TIP, abs=1e-6)
    assert measured.redundancy == 18 and 0.3 < measured.dilution < 10.0


@pytest.mark.parametrize("by_joints", [False, True])
def test_the_stated_covariance_is_the_true_one(machine: MachineModel, by_joints: bool) -> None:
    """300 measure-ups with noise: errors in their own covariance are chi-squared, whose mean is 3."""
    joints = sensor_sigmas(machine) if by_joints else None
    total, many = 0.0, 300
    for seed in range(many):
        touches = surveyed(machine, seed, 6, SIGMA_M, joints)
        measured = measure_up(machine, touches, SIGMA_M, joints)
        error = measured.position - TIP
        honest = measured.covariance / max(1.0, measured.factor) ** 2
        total += float(error @ np.linalg.solve(honest, error))
    low, high = (stats.chi2.ppf(p, 3 * many) for p in (0.0005, 0.9995))
    assert low < total < high


def test_the_tolerance_covers_touches_worse_than_stated(machine: MachineModel) -> None:
    """Noise half as much again as stated: refused as a blunder, or the residuals have widened the tolerance."""
    inside, refused = 0, 0
    for seed in range(200):
        try:
            measured = measure_up(machine, surveyed(machine, 1000 + seed, 8, 1.5 * SIGMA_M), SIGMA_M)
        except MachineError:
            refused += 1
            continue
        inside += bool(np.abs(measured.position - TIP).max() < 3 * measured.tolerance_m)
        assert measured.factor > 0.8
    assert refused < 40 and inside >= 0.97 * (200 - refused)


def test_sensor_sigmas_are_those_of_the_machine_file(machine: MachineModel) -> None:
    assert np.degrees(sensor_sigmas(machine)) == pytest.approx([0.05, 0.1, 0.1, 0.1, 0.2, 0.2])
    assert not sensor_sigmas(load_machine("sun-a")).any()


def test_turning_about_one_axis_cannot_tell(machine: MachineModel) -> None:
    """Boom, stick and bucket all turn about the same axis: how far the tip is off to the side stays open."""
    touches = on_one_point(machine, 3, 8, 0.0, [1, 2, 3])
    with pytest.raises(MachineError, match=r"about another axis too.*found an error of a touch grows"):
        measure_up(machine, touches, SIGMA_M)


def test_postures_too_alike_are_refused(machine: MachineModel) -> None:
    q = np.array(machine.home)
    touches = []
    for k in range(5):
        one = q.copy()
        one[3] += math.radians(2.0 * k)
        touches.append(Touch(frozen(one), frozen(tip_at(machine, one))))
    with pytest.raises(MachineError, match=r"too alike.*turns by 8\.0°.*10° or more"):
        measure_up(machine, touches, SIGMA_M)


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**31), st.integers(0, 5), st.floats(0.08, 2.0))
def test_a_blunder_is_named(machine: MachineModel, seed: int, which: int, metres: float) -> None:
    touches = surveyed(machine, seed, 6, SIGMA_M)
    way = np.random.default_rng(seed).standard_normal(3)
    moved = touches[which].point + metres * way / np.linalg.norm(way)
    touches[which] = Touch(touches[which].q, frozen(moved))
    with pytest.raises(MachineError, match=rf"touch {which + 1}: this touch does not fit"):
        measure_up(machine, touches, SIGMA_M)


def test_honest_touches_are_no_blunder(machine: MachineModel) -> None:
    for seed in range(300):
        measure_up(machine, surveyed(machine, seed, 4, SIGMA_M), SIGMA_M)


@pytest.mark.parametrize(
    ("touches", "sigma_m", "words"),
    [
        ("two", SIGMA_M, "too few touches"),
        ("three same", SIGMA_M, "4 or more"),
        ("mixed", SIGMA_M, "some touches have a place"),
        ("nan", SIGMA_M, "touch 2: not a posture and a place"),
        ("short", SIGMA_M, "touch 1: not a posture and a place"),
        ("four", 0.0, "never exact"),
        ("four", math.nan, "never exact"),
    ],
)
def test_what_is_no_measurement_is_refused(machine: MachineModel, touches: str, sigma_m: float, words: str) -> None:
    good = surveyed(machine, 1, 4, SIGMA_M)
    given_ = {
        "two": good[:2],
        "four": good,
        "three same": [Touch(one.q) for one in good[:3]],
        "mixed": [*good[:3], Touch(good[3].q)],
        "nan": [good[0], Touch(good[1].q, frozen([0.0, math.nan, 0.0])), *good[2:]],
        "short": [Touch(frozen([0.0]), frozen([0.0] * 3)), *good[1:]],
    }[touches]
    with pytest.raises(MachineError, match=words):
        measure_up(machine, given_, sigma_m)


def test_the_entry_makes_a_machine_of_its_own(machine: MachineModel) -> None:
    measured: MeasuredUp = measure_up(machine, surveyed(machine, 9, 8, SIGMA_M), SIGMA_M)
    like = RRE20["attachments"][0]
    entry = yaml.safe_load(yaml.safe_dump(attachment_entry("ditching bucket", measured, 8, like)))
    assert entry["boxes"] == like["boxes"] and entry["mass_kg"] == like["mass_kg"]
    made = machine_from({**RRE20, "attachments": [entry]}, attachment="ditching bucket")
    assert made.T_link_tool[:3, 3] == pytest.approx(measured.position, abs=6e-5)
    assert measured.tolerance_m <= made.tool_tolerance_m < measured.tolerance_m + 1.01e-4


@pytest.mark.parametrize("missing", [("tool",), ("tolerance_m",), ("tool", "tolerance_m")])
def test_an_attachment_that_is_not_measured_up_is_not_mounted(missing: tuple[str, ...]) -> None:
    hammer = {"name": "hammer", "tool": {"position_m": [0, 0, 1]}, "tolerance_m": 0.01}
    for key in missing:
        del hammer[key]
    described = {**RRE20, "attachments": [*RRE20["attachments"], hammer]}
    assert machine_from(described).attachment == "grading bucket"  # listed is not mounted
    with pytest.raises(MachineError, match="hammer is not measured up") as caught:
        machine_from(described, attachment="hammer")
    assert caught.value.element == "attachments[hammer]"
    assert all(f"no {key}" in str(caught.value) for key in missing) and "measure-up" in str(caught.value)


def test_without_sensors_a_declared_tool_is_enough() -> None:
    plain = {key: value for key, value in RRE20.items() if key != "positioning"}
    plain["attachments"] = [{"name": "hammer", "tool": {"position_m": [0, 0, 1]}}]
    assert machine_from(plain).tool_tolerance_m == 0.0
    plain["attachments"] = [{"name": "hammer"}]
    with pytest.raises(MachineError, match="it has no tool"):
        machine_from(plain)
