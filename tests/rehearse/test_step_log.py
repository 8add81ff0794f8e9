"""Logs of steps and stops from files: the programme's own, CSV, and whatever else people hand in."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from workgauge.machine.load import load_machine
from workgauge.rehearse.identify.log import read_step_log
from workgauge.rehearse.identify.programme import Encoders, rehearse_steps
from workgauge.rehearse.identify.result import identify
from workgauge.sim.hydraulics import HydraulicSpec
from workgauge.values.errors import InputError


@pytest.fixture(scope="module")
def mcap(tmp_path_factory):  # type: ignore[no-untyped-def]
    path = tmp_path_factory.mktemp("log") / "steps.mcap"
    rehearse_steps(load_machine("rre20"), path, joints=[1], encoders=Encoders(seed=4))
    return path


def as_csv(log, path: Path, unit: str = "deg") -> Path:  # type: ignore[no-untyped-def]
    scale = 180.0 / np.pi if unit == "deg" else 1.0
    rows = [f"t_s,q_boom_{unit},valve_boom_percent"]
    for t, q, valve in zip(log.t, log.q[:, 1], log.valve[:, 1], strict=True):
        rows.append(f"{float(t)!r},{float(q * scale)!r},{float(valve * 100)!r}")
    path.write_text("\n".join(rows), encoding="utf-8")
    return path


def test_the_programme_stays_off_the_ends_and_excites_its_joint(mcap: Path) -> None:
    machine, log = load_machine("rre20"), read_step_log(mcap)
    assert log.joints == machine.joint_names and log.machine == "rre20" and not any(log.prismatic)
    boom = log.q[:, 1]
    assert boom.min() > machine.q_min[1] + 0.01 and boom.max() < machine.q_max[1] - 0.01
    assert np.ptp(log.q[:, 0]) < 0.01 and log.valve[:, 1].max() == 1.0 and log.valve[:, 1].min() == -1.0
    (found,) = identify(log, machine, ["boom"])
    truth = HydraulicSpec.of_machine(machine, 0.08)
    for i, side in enumerate(found.sides):
        assert side.fit.dead_time_s.low <= truth.dead_time_s[i, 1] <= side.fit.dead_time_s.high
        assert side.fit.lag_s.low <= truth.lag_s[i, 1] <= side.fit.lag_s.high
        assert side.fit.deceleration.low <= truth.deceleration[i, 1] <= side.fit.deceleration.high
    assert found.arm_m == pytest.approx(9.4, abs=0.8)  # boom 5.2, stick 2.4, bucket 0.4, tool 1.4
    with pytest.raises(InputError, match=r"joint swing, positive direction"):
        identify(log, machine)


@pytest.mark.parametrize("unit", ["deg", "rad"])
def test_a_csv_says_the_same(mcap: Path, tmp_path: Path, unit: str) -> None:
    log = read_step_log(mcap)
    again = read_step_log(as_csv(log, tmp_path / "steps.csv", unit))
    assert again.joints == ("boom",) and again.q[:, 0] == pytest.approx(log.q[:, 1], abs=1e-12)
    one, same = identify(log, None, ["boom"])[0], identify(again)[0]
    for a, b in zip(one.sides, same.sides, strict=True):
        assert b.fit.dead_time_s.value == pytest.approx(a.fit.dead_time_s.value, abs=1e-4)
        assert b.fit.deceleration.value == pytest.approx(a.fit.deceleration.value, rel=1e-2)


HEAD = "t_s,q_boom_deg,valve_boom_percent\n"
ROWS = "".join(f"{k * 0.01:.2f},1.0,0\n" for k in range(700))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", r"columns are missing"),
        ("t_s,q_boom_deg\n1,2\n", r"line 1|:1: columns are missing"),
        ("t_s,q_boom_grad,valve_boom_percent\n", r"q_boom_grad: unknown column"),
        ("t_s,t_s,q_boom_deg,valve_boom_percent\n", r"twice"),
        ("t_s,q_boom_deg,valve_arm_percent\n", r"columns are missing"),
        (HEAD, r"too short"),
        (HEAD + "0.00,1.0\n", r"steps\.csv:2: columns are missing or too many"),
        (HEAD + "0.00,1.0,0\n0.01,x,0\n", r"steps\.csv:3: not a number"),
        (HEAD + "0.00,1.0,0\n\n0.01,nan,0\n", r"steps\.csv:4: q at t = 0\.010 s: not a finite number"),
        (HEAD + ROWS.replace("3.00,", "0.50,"), r"steps\.csv:302: q at t = 0\.500 s: time does not go forwards"),
        (HEAD + ROWS.replace("3.00,1.0,0", "3.00,1.0,140"), r"steps\.csv:302: valve.*more than full"),
        (HEAD + ROWS.replace("6.99,", "9.99,"), r"steps\.csv:701: .*a gap of 3\.010 s"),
        (HEAD + ROWS, r"joint boom, positive direction.*does not excite"),
    ],
)
def test_a_csv_that_cannot_be_used_is_refused_with_the_line(tmp_path: Path, text: str, words: str) -> None:
    path = tmp_path / "steps.csv"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=words):
        identify(read_step_log(path))


@settings(max_examples=100, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    data=st.binary(max_size=300) | st.text(alphabet='t_s,qvale\n0123456789.-"\r\x00', max_size=200).map(str.encode)
)
@pytest.mark.parametrize("suffix", ["csv", "mcap"])
def test_junk_is_refused(tmp_path: Path, suffix: str, data: bytes) -> None:
    path = tmp_path / f"junk.{suffix}"
    path.write_bytes(data)
    with pytest.raises(InputError):
        read_step_log(path)


def test_a_log_that_is_not_there_is_refused(tmp_path: Path) -> None:
    for name in ("no.csv", "no.mcap"):
        with pytest.raises(InputError, match="cannot be read"):
            read_step_log(tmp_path / name)
