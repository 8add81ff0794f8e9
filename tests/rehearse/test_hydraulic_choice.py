"""What a scenario says of its joints becomes hydraulics; what makes no sense is refused by name."""

import functools
import math

import numpy as np
import pytest
from pydantic import TypeAdapter, ValidationError

from workgauge.machine.load import load_machine
from workgauge.machine.stopping import StoppingModel
from workgauge.rehearse.hydraulic_choice import HydraulicChoice, Joints, hydraulic_spec
from workgauge.sim.hydraulics import Change, HydraulicSpec
from workgauge.values.errors import ScenarioError


@functools.cache
def machine():
    return load_machine("rre20")


def spec(content: object) -> HydraulicSpec:
    made = hydraulic_spec(TypeAdapter(Joints).validate_python(content), machine())
    assert made is not None
    return made


def test_ideal_is_none_and_hydraulic_is_the_files() -> None:
    assert hydraulic_spec("ideal", machine()) is None
    for content in ("hydraulic", {}):
        made, model = spec(content), StoppingModel.of(machine())
        assert (made.dead_time_s == model.dead_time_s).all() and (made.deceleration == model.deceleration).all()
        assert made.pump is machine().pump and not made.dead_band.any() and math.isinf(made.valve_rate)


def test_numbers_of_its_own_for_all_by_joint_and_by_direction() -> None:
    made = spec(
        {
            "dead_time_s": 0.3,
            "dead_band_percent": 8,
            "deceleration_deg_s2": 90,
            "valve_full_travel_s": 0.25,
            "by_joint": {
                "boom": {"dead_time_s": 0.4, "negative": {"dead_time_s": 0.5, "acceleration_deg_s2": 200}},
                "stick": {"natural_frequency_rad_s": 9, "damping": 0.4, "positive": {"lag_s": 0.1}},
            },
        }
    )
    assert made.dead_time_s[:, 0].tolist() == [0.3, 0.3] and made.dead_time_s[:, 1].tolist() == [0.4, 0.5]
    assert (made.dead_band == 0.08).all() and made.valve_rate == 4.0
    assert made.deceleration == pytest.approx(np.full((2, 6), math.radians(90)))
    assert made.acceleration is not None and made.natural_frequency is not None and made.damping is not None
    assert np.degrees(made.acceleration[:, 1]) == pytest.approx([90, 200])
    assert made.natural_frequency[:, 2].tolist() == [0.0, 9.0] and made.damping[1, 2] == 0.4
    assert made.lag_s[0, 2] == 0.1 and made.natural_frequency[:, 0].tolist() == [0.0, 0.0]


def test_changes_pump_and_draw() -> None:
    made = spec(
        {
            "changes": [{"from_s": 10, "dead_time_factor": 2}, {"from_s": 3, "until_s": 4, "joints": ["bucket"]}],
            "pump_flow_l_min": 100,
        }
    )
    assert made.script == (Change(10.0, dead_time=2.0), Change(3.0, 4.0, joints=(3,)))
    assert made.pump is not None and made.pump.flow == pytest.approx(0.1 / 60)
    assert spec({"pump": False}).pump is None
    one, same, other = spec({"vary_seed": 4}), spec({"vary_seed": 4}), spec({"vary_seed": 5})
    assert (one.dead_time_s == same.dead_time_s).all() and (one.dead_time_s != other.dead_time_s).any()
    assert np.abs(one.dead_time_s / spec({}).dead_time_s - 1).max() <= 0.3 + 1e-12
    assert np.abs(spec({"vary_seed": 4, "vary_percent": 5}).lag_s / spec({}).lag_s - 1).max() <= 0.05 + 1e-12


@pytest.mark.parametrize(
    "bad",
    [
        "sluggish",
        {"dead_time": 0.3},
        {"dead_time_s": -0.1},
        {"dead_time_s": math.nan},
        {"lag_s": 0.1, "natural_frequency_rad_s": 9},
        {"damping": 0.5},
        {"dead_band_percent": 60},
        {"vary_percent": 20},
        {"pump": False, "pump_flow_l_min": 100},
        {"changes": [{"from_s": 5, "until_s": 4}]},
        {"changes": [{"from_s": 5, "joints": []}]},
        {"changes": [{"from_s": 5, "speed_factor": 2}]},
        {"by_joint": {"boom": {"positive": {"speed": 3}}}},
    ],
)
def test_what_makes_no_sense_is_refused(bad: object) -> None:
    with pytest.raises(ValidationError):
        TypeAdapter(Joints).validate_python(bad)


@pytest.mark.parametrize(
    ("bad", "words"),
    [
        ({"by_joint": {"arm": {}}}, r"by_joint.*no such joint.*arm"),
        ({"changes": [{"from_s": 1, "joints": ["arm"]}]}, r"changes.*no such joint"),
        ({"by_joint": {"boom": {"deceleration_m_s2": 1}}}, r"boom has deg/s2"),
    ],
)
def test_what_the_machine_does_not_have_is_refused_by_name(bad: object, words: str) -> None:
    with pytest.raises(ScenarioError, match=words):
        hydraulic_spec(HydraulicChoice.model_validate(bad), machine())
