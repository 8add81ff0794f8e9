"""A `positioning` section that does not fit its machine is refused by name, with the line and what would fit."""

import copy
from collections.abc import Callable
from importlib import resources
from pathlib import Path
from typing import Any

import pytest
import yaml

from workgauge.machine.load import catalogue, load_machine
from workgauge.values.errors import MachineError

RRE20: dict[str, Any] = yaml.safe_load(
    (Path(str(resources.files("workgauge"))) / "shipped" / "machines" / "rre20.yaml").read_text()
)
Change = Callable[[dict[str, Any]], None]


def put(*path: Any) -> Change:
    """Set the value (last) at a path of keys of the section."""

    def change(section: dict[str, Any]) -> None:
        node: Any = section
        for part in path[:-2]:
            node = node[part]
        node[path[-2]] = path[-1]

    return change


def both(*changes: Change) -> Change:
    def change(section: dict[str, Any]) -> None:
        for one in changes:
            one(section)

    return change


def drop(*path: Any) -> Change:
    def change(section: dict[str, Any]) -> None:
        node: Any = section
        for part in path[:-1]:
            node = node[part]
        del node[path[-1]]

    return change


WIRE = {"stroke_m": [0.0, 0.5, 1.0], "position_deg": [-40, 10, 60]}

#: what is done to the section, then: element after `positioning.`, words in the message, value, words in `allowed`
REFUSED: dict[str, tuple[Change, str, str, Any, str | None]] = {
    "unknown antenna": (
        put("receivers", 0, "antenna", "mast"),
        "receivers[left receiver].antenna", "no such sensor", "mast", "antenna left, antenna right"),
    "antenna that is none": (
        put("receivers", 0, "antenna", "boom imu"),
        "receivers[left receiver].antenna", "kind imu, not gnss_antenna", "boom imu", "antenna left"),
    "receiver name twice": (
        put("receivers", 1, "name", "left receiver"),
        "receivers[left receiver].name", "used twice", "left receiver", "unique"),
    "one antenna for two": (
        put("receivers", 1, "antenna", "antenna left"),
        "receivers[right receiver].antenna", "another receiver already", "antenna left", "one each"),
    "one port for two": (
        put("receivers", 1, "port", "gnss-left"),
        "receivers[right receiver].port", "cannot be told apart", "gnss-left", "a port each, or a `talker` each"),
    "one talker for two": (
        both(put("receivers", 1, "port", "gnss-left"), put("receivers", 0, "talker", "GN"),
             put("receivers", 1, "talker", "GN")),
        "receivers[right receiver].port", "cannot be told apart", "gnss-left", "talker"),
    "float surer than fixed": (
        put("receivers", 0, "sigmas", {"float_m": [0.001, 0.5]}),
        "receivers[left receiver].sigmas.float_m", "surer than fixed_m", [0.001, 0.5], "0.015"),
    "unknown master": (
        put("heading", "master", "mast"), "heading.master", "no such sensor", "mast", "antenna left"),
    "rover that is no antenna": (
        put("heading", "rover", "cabin imu"), "heading.rover", "kind imu", "cabin imu", "antenna left"),
    "one antenna as a baseline": (
        put("heading", "rover", "antenna right"), "heading.rover", "two antennas", "antenna right", "another"),
    "antenna without receiver": (
        drop("receivers", 1), "heading.master", "without a receiver", "antenna right", "antenna left"),
    "tilt by an encoder": (
        put("tilt", "sensor", "swing encoder"), "tilt.sensor", "kind encoder", "swing encoder", "undercarriage tilt"),
    "unknown tilt": (put("tilt", "sensor", "bubble"), "tilt.sensor", "no such sensor", "bubble", "boom imu"),
    "unknown joint": (put("joints", 1, "joint", "jib"), "joints[1].joint", "no such joint", "jib", "swing, boom"),
    "joint twice": (put("joints", 2, "joint", "boom"), "joints[2].joint", "measured twice", "boom", "one entry"),
    "joint left out": (drop("joints", 3), "joints", "nothing measures joint bucket", None, "one entry"),
    "unknown sensor": (
        put("joints", 0, "sensor", "dial"), "joints[0].sensor", "no such sensor", "dial", "swing encoder"),
    "sensor of another kind": (
        put("joints", 0, "sensor", "cabin imu"), "joints[0].sensor", "kind imu, not encoder", "cabin imu", "encoder"),
    "sensor of two joints": (
        put("joints", 4, "sensor", "swing encoder"),
        "joints[4].sensor", "another joint", "swing encoder", "one each"),
    "inclinometer on another link": (
        put("joints", 1, "sensor", "stick imu"), "joints[1].sensor", "sits on stick", "stick imu", "on boom"),
    "inclinometer before that is behind": (
        put("joints", 1, "before", "stick imu"), "joints[1].before", "not before joint boom", "stick imu", "cabin"),
    "unknown inclinometer before": (
        put("joints", 1, "before", "bubble"), "joints[1].before", "no such sensor", "bubble", "boom imu"),
    "before without inclination": (
        put("joints", 0, "before", "boom imu"), "joints[0].before", "kind: inclination", "boom imu", None),
    "tilt behind the joint": (
        put("tilt", "sensor", "bracket imu"), "joints[1].joint", "not before joint boom", "bracket imu", "cabin"),
    "swing by gravity": (
        both(put("joints", 0, "kind", "inclination"), put("joints", 0, "sensor", "cabin imu")),
        "joints[0].kind", "about the vertical", "inclination", "encoder"),
    "sign of an inclinometer": (
        put("joints", 1, "sign", -1), "joints[1].sign", "rpy_deg", -1, "1"),
    "metres for an angle": (put("joints", 1, "sigma_m", 0.1), "joints[1].sigma_m", "turns", 0.1, None),
    "wire encoder without one": (
        both(put("joints", 1, "kind", "wire_encoder"), put("joints", 1, "calibration", WIRE)),
        "joints[1].sensor", "not wire_encoder", "boom imu", "none in `sensors`"),
    "dead reckoning shorter than a fix": (
        put("thresholds", {"dead_reckoning_s": 0.1}),
        "thresholds.dead_reckoning_s", "does not make sense", 0.1, "fix_age_s (0.5)"),
    "frozen shorter than dead reckoning": (
        put("thresholds", {"chassis_frozen_s": 1.0}),
        "thresholds.chassis_frozen_s", "does not make sense", 1.0, "dead_reckoning_s (2)"),
    "any heading agrees": (
        put("thresholds", {"heading_deg": 120}), "thresholds.heading_deg", "does not make sense", 120, "below 90"),
    "sensors of last minute": (
        put("thresholds", {"link_age_s": 60}), "thresholds.link_age_s", "does not make sense", 60, "1 or less"),
    "negative threshold": (
        put("thresholds", {"baseline_m": -1}), "thresholds.baseline_m", "too small", -1, "above 0"),
    "more than all shared": (
        put("heading", "shared_error", 1.5), "heading.shared_error", "too large", 1.5, "1 or less"),
}  # fmt: skip


@pytest.mark.parametrize("fault", REFUSED)
def test_a_fault_is_named(tmp_path: Path, fault: str) -> None:
    change, element, words, value, allowed = REFUSED[fault]
    description = copy.deepcopy(RRE20)
    change(description["positioning"])
    path = tmp_path / "machine.yaml"
    path.write_text(yaml.safe_dump(description, sort_keys=False))
    with pytest.raises(MachineError) as caught:
        load_machine(path)
    error = caught.value
    assert error.element == f"positioning.{element}"
    assert words in error.message
    if value is not None:
        assert error.value == value
    if allowed is not None:
        assert error.allowed is not None and allowed in error.allowed
    assert error.file == str(path) and error.line is not None
    assert error.line > path.read_text().split("positioning:")[0].count("\n")
    assert "\n" not in str(error)


def test_antennas_one_above_the_other_are_refused(tmp_path: Path) -> None:
    """The cabin's y axis points up: a mistake easily made."""
    description = copy.deepcopy(RRE20)
    left, right = (sensor for sensor in description["sensors"] if sensor["kind"] == "gnss_antenna")
    left["position_m"] = [right["position_m"][0], right["position_m"][1] + 2.2, right["position_m"][2]]
    path = tmp_path / "machine.yaml"
    path.write_text(yaml.safe_dump(description, sort_keys=False))
    with pytest.raises(MachineError, match="seen from above") as caught:
        load_machine(path)
    assert caught.value.element == "positioning.heading.rover" and caught.value.line is not None


def test_a_wire_encoder_and_two_talkers_on_one_port(tmp_path: Path) -> None:
    description = copy.deepcopy(RRE20)
    description["sensors"].append(
        {"name": "boom wire", "kind": "wire_encoder", "link": "boom", "position_m": [0, 0, 0]}
    )
    section = description["positioning"]
    section["joints"][1] = {"joint": "boom", "kind": "wire_encoder", "sensor": "boom wire", "calibration": WIRE}
    section["joints"][2]["before"] = "cabin imu"
    for i, talker in enumerate(("GP", "GN")):
        section["receivers"][i] |= {"port": "gnss", "talker": talker}
    section["heading"] = {"kind": "moving_base", "master": "antenna right", "rover": "antenna left"}
    path = tmp_path / "machine.yaml"
    path.write_text(yaml.safe_dump(description, sort_keys=False))
    machine = load_machine(path)
    assert machine.positioning is not None and machine.positioning.joints[1].calibration is not None
    section["joints"][1]["calibration"] = {"stroke_m": [0, 1], "position_m": [0, 1]}
    path.write_text(yaml.safe_dump(description, sort_keys=False))
    with pytest.raises(MachineError, match=r"calibration.position_m: joint boom turns \(allowed: `position_deg`\)"):
        load_machine(path)


def test_shipped_machines_fit() -> None:
    assert any(load_machine(name).positioning is not None for name in catalogue())
