"""What a scenario may say of sensors and faults, and what the simulator makes of it."""

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import BaseModel, TypeAdapter, ValidationError

from workgauge.geodesy.crs import ProjectedCrs
from workgauge.geodesy.frame import SiteFrame
from workgauge.machine.load import load_machine
from workgauge.rehearse import sensing
from workgauge.rehearse.scenario_file import load_scenario
from workgauge.rehearse.sensing import FaultChoice, SensorChoice, Sensors
from workgauge.sim.sensors.faults import FaultKind
from workgauge.sim.sensors.kit import SensorKit
from workgauge.sim.sensors.settings import RATES_HZ, SensorSettings
from workgauge.values.errors import InputError, ScenarioError
from workgauge.values.navigation import FixQuality

SENSORS: TypeAdapter[Any] = TypeAdapter(Sensors)
FAULTS: TypeAdapter[Any] = TypeAdapter(tuple[FaultChoice, ...])


def sensors(text: str) -> SensorChoice:
    return SENSORS.validate_python(yaml.safe_load(text))


def fault(text: str):
    (one,) = FAULTS.validate_python([yaml.safe_load(text)])
    return one.fault()


def place(error: ValidationError, top: str) -> str:
    """Return where an error is, without the words by which choices between types are told apart."""
    loc = [str(part) for part in error.errors()[0]["loc"] if not str(part).startswith("<")]
    if top == "faults":
        del loc[1:2]
    return ".".join([top, *loc])


def test_perfect_stays_a_word() -> None:
    assert SENSORS.validate_python("perfect") == "perfect"


def test_what_is_left_out_is_as_the_simulator_has_it() -> None:
    """The defaults stand in two places; they are the same but for the gyro, whose key is in degrees."""
    chosen, default = sensors("{}").settings(), SensorSettings()
    assert chosen.receivers == default.receivers
    assert chosen.heading == default.heading
    assert (chosen.each, chosen.faults, chosen.geoid_separation_m) == ({}, (), None)
    assert chosen.links.gyro_rad_s == pytest.approx(math.radians(0.1))
    assert chosen.links.rate_hz == default.links.rate_hz == 100


def test_rates_are_those_the_simulator_can_keep() -> None:
    for rate in RATES_HZ:
        assert sensors(f"{{links: {{rate_hz: {rate}}}}}").settings().links.rate_hz == rate
    for rate in (0, 3, 15, 1000, "fast"):
        with pytest.raises(ValidationError):
            sensors(f"{{links: {{rate_hz: {rate}}}}}")


@pytest.mark.parametrize(("noise", "scale"), [("none", 0.0), ("datasheet", 1.0), ("{scale: 2.5}", 2.5)])
def test_noise_reaches_every_sensor(noise: str, scale: float) -> None:
    found = sensors(f"{{noise: {noise}}}").settings()
    assert found.receivers.noise.scale == found.heading.scale == found.links.scale == scale


def test_noise_in_numbers_counts_for_the_qualities_it_names() -> None:
    found = sensors("{noise: {fixed_m: [0.03, 0.05], correlated: 1, common: 0, correlation_s: 9}}").settings()
    noise = found.receivers.noise
    assert noise.sigmas_m == {FixQuality.FIXED: (0.03, 0.05)}
    assert (noise.correlated, noise.common, noise.correlation_s) == (1.0, 0.0, 9.0)


def test_one_receiver_differs_only_in_the_keys_written_for_it() -> None:
    found = sensors(
        "{noise: none, receivers: {rate_hz: 10, stated: 0.5, each: "
        "{left receiver: {protocol: ubx, noise: datasheet}, right receiver: {quality: float}}}}"
    ).settings()
    left, right = found.each["left receiver"], found.each["right receiver"]
    assert (left.rate_hz, left.stated, left.protocol, left.noise.scale) == (10, 0.5, "ubx", 1.0)
    assert (right.rate_hz, right.protocol, right.quality, right.noise.scale) == (10, "nmea", FixQuality.FLOAT, 0.0)
    assert found.receivers.quality is FixQuality.FIXED


def test_every_fault_can_be_written_and_its_units_are_those_of_its_keys() -> None:
    written = {
        "float": "{}",
        "differential": "{}",
        "single": "{receiver: left receiver}",
        "outage": "{from_s: 1.5, for_s: 0.25}",
        "silence": "{port: links}",
        "jump": "{offset_m: [1, 2, 3], ramp_s: 2}",
        "frozen": "{clock: stopped}",
        "swapped": "{}",
        "antenna_moved": "{receiver: left receiver, offset_m: [0, 0, 0.1]}",
        "correction_age": "{}",
        "sensor_jump": "{sensor: boom imu, offset_deg: 90}",
        "bad_bytes": "{flipped: 0.5}",
        "foreign_receiver": "{receiver: left receiver}",
        "latency": "{delay_s: 0.3, sensor: all}",
        "clock_step": "{step_s: -2}",
    }
    assert set(written) == {str(kind) for kind in FaultKind}
    found = {do: fault(f"{{do: {do}, {text[1:-1]}}}") for do, text in written.items()}
    assert all(str(one.kind) == do for do, one in found.items())
    assert (found["outage"].from_ns, found["outage"].until_ns) == (1_500_000_000, 1_750_000_000)
    assert (found["float"].from_ns, found["float"].until_ns) == (0, None)
    assert found["sensor_jump"].offset == pytest.approx(math.pi / 2)
    assert fault("{do: sensor_jump, sensor: wire, offset_m: 0.2}").offset == 0.2
    assert found["frozen"].clock_stopped and not fault("{do: frozen}").clock_stopped
    assert (found["jump"].offset_m, found["jump"].ramp_s) == ((1.0, 2.0, 3.0), 2.0)
    assert (found["latency"].delay_s, found["latency"].sensor) == (0.3, "all")


@pytest.mark.parametrize(
    ("text", "where", "words"),
    [
        ("perfct", "sensors", "neither `perfect` nor a mapping"),
        ("[1]", "sensors", "neither `perfect` nor a mapping"),
        ("{sed: 1}", "sensors.sed", "Extra inputs"),
        ("{noise: loud}", "sensors.noise", "neither `datasheet` nor `none`"),
        ("{noise: {scl: 1}}", "sensors.noise.scl", "Extra inputs"),
        ("{noise: {correlated: 1.5}}", "sensors.noise.correlated", "less than or equal to 1"),
        ("{noise: {fixed_m: [0.1]}}", "sensors.noise.fixed_m.1", "required"),
        ("{receivers: {protocol: rtcm}}", "sensors.receivers.protocol", "'nmea', 'ubx' or 'both'"),
        ("{receivers: {each: {a: {rate: 1}}}}", "sensors.receivers.each.a.rate", "Extra inputs"),
        ("{seed: -1}", "sensors.seed", "greater than or equal to 0"),
        ("{geoid_separation_m: .nan}", "sensors.geoid_separation_m", "150"),
    ],
)
def test_a_wrong_choice_is_named_at_its_place(text: str, where: str, words: str) -> None:
    with pytest.raises(ValidationError) as caught:
        sensors(text)
    assert place(caught.value, "sensors") == where
    assert words in caught.value.errors()[0]["msg"]


@pytest.mark.parametrize(
    ("text", "where", "words"),
    [
        ("{do: flaot}", "faults.0", "'float', 'differential'"),
        ("{from_s: 1}", "faults.0", "do"),
        ("{do: float, sensor: boom imu}", "faults.0.sensor", "Extra inputs"),
        ("{do: jump}", "faults.0.offset_m", "required"),
        ("{do: float, for_s: 0}", "faults.0.for_s", "greater than 0"),
        ("{do: float, from_s: -1}", "faults.0.from_s", "greater than or equal to 0"),
        ("{do: silence, receiver: a, port: b}", "faults.0", "at most one of receiver, sensor, port"),
        ("{do: sensor_jump, sensor: a}", "faults.0", "exactly one of offset_deg, offset_m"),
        ("{do: foreign_receiver, receiver: a, talker: gp}", "faults.0.talker", "pattern"),
        ("{do: latency, delay_s: .inf}", "faults.0.delay_s", "less than or equal to 3600"),
        ("{do: jump, offset_m: [.nan, 0, 0]}", "faults.0.offset_m.0", "equal to"),
    ],
)
def test_a_wrong_fault_is_named_at_its_place(text: str, where: str, words: str) -> None:
    with pytest.raises(ValidationError) as caught:
        fault(text)
    assert place(caught.value, "faults") == where
    assert words in caught.value.errors()[0]["msg"]


@pytest.mark.parametrize(
    ("written", "line", "element", "message"),
    [
        ("sensors:\n  noise: {scl: 1}\n", 2, "sensors.noise.scl", "unknown key"),
        ("sensors: perfct\n", 1, "sensors", "is neither `perfect` nor a mapping"),
        ("sensors:\n  receivers:\n    each:\n      a: {hz: 1}\n", 4, "sensors.receivers.each.a.hz", "unknown key"),
        ("faults:\n  - {do: float}\n  - do: jump\n    ramp_s: -1\n    offset_m: [0, 0, 0]\n", 4,
         "faults.1.ramp_s", "greater than or equal to 0"),
    ],
)  # fmt: skip
def test_a_scenario_file_says_in_which_line(
    tmp_path: Path, written: str, line: int, element: str, message: str
) -> None:
    file = tmp_path / "bad.yaml"
    start = (
        "site: {shipped: double_track}\nmachine: rre20\ntitle: t\nstart: {on_track: {alignment: a, distance_m: 1}}"
    )
    file.write_text(f"{written}{start}\ndrive: [{{do: hold, for_s: 1}}]\n", encoding="utf-8")
    with pytest.raises(ScenarioError, match=message) as caught:
        load_scenario(file)
    assert (caught.value.file, caught.value.line, caught.value.element) == (str(file), line, element)


def test_the_schema_names_every_fault_and_says_what_keys_are_for() -> None:
    schema = json.dumps(FAULTS.json_schema())
    assert all(f'"{kind}"' in schema for kind in FaultKind)
    assert "unless the machine's file tells" in json.dumps(SENSORS.json_schema())


def test_every_part_refuses_unknown_keys() -> None:
    parts = [one for one in vars(sensing).values() if isinstance(one, type) and issubclass(one, BaseModel)]
    mine = [one for one in parts if one.__module__ == sensing.__name__]
    assert len(mine) > 20
    assert all(one.model_config.get("extra") == "forbid" and one.model_config.get("frozen") for one in mine)


@pytest.mark.parametrize("protocol", ["nmea", "ubx", "both"])
def test_the_worst_that_can_be_written_still_runs(protocol: str) -> None:
    chosen = sensors(
        "{noise: {single_m: [1000, 1000], fixed_m: [1000, 1000], scale: 100, velocity_m_s: 100, gyro_deg_s: 100}, "
        f"receivers: {{protocol: {protocol}, stated: 100, correction_age_s: 1.0e+6, satellites: 99, "
        "sentences: [RMC, GGA, GST, VTG, GLL, ZDA, 'PTNL,GGK'], messages: [NAV-PVT, NAV-HPPOSLLH, NAV-COV]}, "
        "geoid_separation_m: -150}"
    )
    faults = [
        "{do: jump, offset_m: [-10000, 10000, -10000]}",
        "{do: clock_step, step_s: -1.0e+6}",
        "{do: correction_age}",
        "{do: foreign_receiver, receiver: left receiver, offset_m: [10000, 10000, 10000]}",
        "{do: sensor_jump, sensor: boom imu, offset_deg: 1.0e+9}",
    ]
    written = FAULTS.validate_python([yaml.safe_load(one) for one in faults])
    machine, frame = load_machine("rre20"), SiteFrame(ProjectedCrs.from_epsg(3879), [25487300.0, 6714600.0, 100.0])
    kit = SensorKit(machine, frame.crs, frame, chosen.settings(written))
    for t_ns in range(0, 2_000_000_001, 50_000_000):
        kit.advance(t_ns, machine.home, np.eye(4))
    assert len(kit.read(4_000_000_000)) > 40


SCALARS = st.one_of(
    st.sampled_from(["left receiver", "boom imu", "links", "all", "heading", "none", "float", "nmea", "GGA"]),
    st.integers(-2, 30),
    st.floats(-1.0, 50.0),
    st.none(),
    st.booleans(),
)
KEYS = sorted({key for part in vars(sensing).values() if isinstance(part, type) and issubclass(part, BaseModel)
               for key in part.model_fields})  # fmt: skip
VALUES = st.recursive(
    SCALARS,
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.sampled_from(KEYS), inner, max_size=4),
    max_leaves=8,
)


@settings(max_examples=150, deadline=None)
@given(
    said=st.dictionaries(st.sampled_from(list(SensorChoice.model_fields)), VALUES, max_size=3),
    wrong=st.lists(
        st.builds(
            lambda do, rest: {"do": do, **rest},
            st.sampled_from([str(kind) for kind in FaultKind]),
            st.dictionaries(st.sampled_from(KEYS), VALUES, max_size=3),
        ),
        max_size=2,
    ),
)
def test_whatever_is_written_is_refused_or_runs(said: dict[str, Any], wrong: list[dict[str, Any]]) -> None:
    try:
        choice, faults = SENSORS.validate_python(said), FAULTS.validate_python(wrong)
    except ValidationError:
        return
    machine, frame = load_machine("rre20"), SiteFrame(ProjectedCrs.from_epsg(3879), [25487300.0, 6714600.0, 100.0])
    try:
        kit = SensorKit(machine, frame.crs, frame, choice.settings(faults), choice.seed)
    except InputError:
        return
    for t_ns in range(0, 200_000_001, 100_000_000):
        kit.advance(t_ns, machine.home, np.eye(4))
        kit.read(t_ns)
