"""The chatter measure against signals whose content above 2 Hz is known in closed form."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from workgauge.rehearse.chatter import above, accelerations, chatter, spectrum
from workgauge.values.errors import InputError

DT = 0.01


def wave(hz: float, acceleration: float, seconds: float = 20.0, dt: float = DT) -> np.ndarray:
    """Joint velocities (N, 1) whose acceleration is a sinusoid of that amplitude, begun and ended gently."""
    t = np.arange(0.0, seconds, dt)
    gently = np.sin(math.pi / 2 * np.clip(np.minimum(t, seconds - t) / 2.0, 0.0, 1.0)) ** 2
    return (gently * acceleration / (2 * math.pi * hz) * np.sin(2 * math.pi * hz * t))[:, None]


def rms_of(seconds: float = 20.0) -> float:
    """Root mean square of a sinusoid of amplitude 1 that is faded in and out over 2 s each."""
    return math.sqrt(0.5 * (seconds - 4.0 + 2 * 2.0 * 3 / 8) / seconds)


@pytest.mark.parametrize("dt", [0.002, 0.01, 0.02])
@pytest.mark.parametrize("hz", [3.0, 5.0])
def test_a_fast_sinusoid_counts_fully_at_any_tick(hz: float, dt: float) -> None:
    found = chatter(wave(hz, 0.7, dt=dt), np.zeros((round(20 / dt), 1)), dt)
    assert found is not None
    assert found.by_joint[0] == pytest.approx(0.7 * rms_of(), rel=0.05)


@pytest.mark.parametrize("hz", [0.2, 0.5, 1.0])
def test_a_slow_sinusoid_counts_nothing(hz: float) -> None:
    found = chatter(wave(hz, 0.7), np.zeros((2000, 1)), DT)
    assert found is not None
    assert found.by_joint[0] < 0.7 * 0.01


def test_white_acceleration_counts_by_its_share_of_the_band() -> None:
    rng = np.random.default_rng(3)
    velocity = np.cumsum(rng.normal(size=(50_000, 2)), axis=0) * DT
    found = chatter(velocity, np.zeros_like(velocity), DT)
    assert found is not None
    assert found.by_joint == pytest.approx(np.full(2, math.sqrt(1 - 2 / 50)), rel=0.03)
    assert found.total == pytest.approx(math.sqrt(2 * (1 - 2 / 50)), rel=0.03)


def test_a_jump_of_the_velocity_has_the_energy_of_an_impulse() -> None:
    velocity = np.zeros((1000, 1))
    velocity[500:] = 0.3
    found = chatter(velocity, np.zeros_like(velocity), DT)
    assert found is not None
    # an impulse of area 0.3 has the spectrum 0.3 everywhere: 0.09 times the band on both sides
    energy = 0.09 * 2 * (0.5 / DT - 2.0)
    assert found.by_joint[0] ** 2 * 1000 * DT == pytest.approx(energy, rel=0.02)


def test_a_command_that_alternates_counts_fully() -> None:
    velocity = 0.01 * (-1.0) ** np.arange(1000)[:, None]
    found = chatter(velocity, np.zeros_like(velocity), DT)
    assert found is not None
    assert found.by_joint[0] == pytest.approx(2 * 0.01 / DT, rel=0.01)


def test_what_the_hands_do_is_no_chatter() -> None:
    hands = np.zeros((1000, 2))
    hands[300:600, 0] = 0.4
    found = chatter(hands, hands, DT)
    assert found is not None
    assert found.total == 0.0
    assert found.levers[0] > 0.0
    less = chatter(0.5 * hands, hands, DT)
    assert less is not None
    assert less.total == 0.0


def test_one_joint_s_answer_to_another_s_lever_is_its_own_but_no_chatter_in_all() -> None:
    hands, answer = np.zeros((1000, 2)), np.zeros((1000, 2))
    hands[400:, 0] = 0.4
    answer[400:, 1] = 0.3
    found = chatter(answer, hands, DT)
    assert found is not None
    assert found.total == pytest.approx(0.0, abs=1e-6)
    assert found.by_joint[1] == pytest.approx(found.commanded[1])
    assert found.by_joint[0] == 0.0


def test_quiet_hands_now_do_not_excuse_chatter_later() -> None:
    hands = np.zeros((2000, 1))
    hands[200:] = 0.9
    shaken = hands.copy()
    shaken[1000:] += wave(5.0, 0.5, 10.0)
    alone = chatter(shaken - hands, np.zeros_like(hands), DT)
    found = chatter(shaken, hands, DT)
    assert found is not None
    assert alone is not None
    assert found.by_joint[0] == pytest.approx(alone.by_joint[0], rel=0.01)
    assert found.levers[0] > found.by_joint[0]


@given(st.integers(0, 2**32 - 1), st.floats(0.1, 10.0), st.integers(1, 40))
def test_laws(seed: int, factor: float, ticks: int) -> None:
    rng = np.random.default_rng(seed)
    commanded, wanted = rng.normal(size=(2, ticks, 3))
    found, scaled = chatter(commanded, wanted, DT), chatter(factor * commanded, factor * wanted, DT)
    assert found is not None
    assert scaled is not None
    assert np.allclose(scaled.by_joint, factor * found.by_joint, rtol=1e-6, atol=1e-6 * scaled.commanded.max())
    assert (found.by_joint <= found.commanded * (1 + 1e-9)).all()
    free = chatter(commanded, np.zeros_like(wanted), DT)
    assert free is not None
    assert np.allclose(free.by_joint, free.commanded, atol=1e-6)
    assert found.total <= np.linalg.norm(found.by_joint) * (1 + 1e-9) + 1e-6
    assert free.total == pytest.approx(np.linalg.norm(free.by_joint), rel=1e-6)


def test_the_filter_does_not_shift_time() -> None:
    signal = np.zeros((401, 1))
    signal[200] = 1.0
    passed = above(signal, DT)[:, 0]
    assert np.allclose(passed, passed[::-1], atol=1e-9)
    assert passed.argmax() == 200


def test_the_spectrum_has_all_the_energy_and_its_peak_where_it_is() -> None:
    rng = np.random.default_rng(1)
    velocity = np.cumsum(rng.normal(size=(20_000, 1)), axis=0) * DT + wave(8.0, 3.0, 200.0)
    f, density = spectrum(velocity, DT)
    assert f[density[:, 0].argmax()] == pytest.approx(8.0, abs=0.5)
    assert float(density.sum() * (f[1] - f[0])) == pytest.approx(
        float((accelerations(velocity, DT) ** 2).mean()), rel=0.05
    )


def test_a_tick_too_slow_to_show_it_has_none() -> None:
    assert chatter(np.zeros((10, 1)), np.zeros((10, 1)), 0.25) is None
    assert chatter(np.zeros((0, 2)), np.zeros((0, 2)), DT) is None
    assert chatter(np.zeros((3, 1)), np.zeros((3, 1)), 0.1) is not None


@pytest.mark.parametrize(
    ("commanded", "wanted", "dt"),
    [
        (np.zeros((3, 2)), np.zeros((3, 1)), DT),
        (np.zeros(3), np.zeros(3), DT),
        (np.full((3, 1), np.nan), np.zeros((3, 1)), DT),
        (np.zeros((3, 1)), np.zeros((3, 1)), 0.0),
    ],
)
def test_what_cannot_be_judged_is_refused(commanded: np.ndarray, wanted: np.ndarray, dt: float) -> None:
    with pytest.raises(InputError):
        chatter(commanded, wanted, dt)


def test_in_json_by_joint() -> None:
    found = chatter(wave(5.0, 1.0), np.zeros((2000, 1)), DT)
    assert found is not None
    plain = found.as_json(("swing",))
    assert plain["total"] == plain["by_joint"]["swing"] > 0.5
    assert plain["above_hz"] == 2.0
