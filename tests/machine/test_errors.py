"""Bad machine files: each refused with one message that names file, line, key, value and what is allowed."""

import copy
import math
from collections.abc import Callable
from importlib import resources
from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from workgauge.machine.description import MachineDescription, json_schema
from workgauge.machine.load import load_machine, machine_from
from workgauge.machine.model import MachineModel
from workgauge.values.errors import InputError, MachineError

SHIPPED = resources.files("workgauge") / "shipped" / "machines"
RRE20: dict[str, Any] = yaml.safe_load((SHIPPED / "rre20.yaml").read_text())
BROKK5: dict[str, Any] = yaml.safe_load((SHIPPED / "brokk5.yaml").read_text())

Change = Callable[[dict[str, Any]], Any]


def put(*place: Any) -> Change:
    """Return a change that sets the value at a path: `put("joints", 1, "lower_deg", 80)`."""

    def change(description: dict[str, Any]) -> None:
        node: Any = description
        for part in place[:-2]:
            node = node[part]
        node[place[-2]] = place[-1]

    return change


def drop(*place: Any) -> Change:
    """Return a change that removes the value at a path."""

    def change(description: dict[str, Any]) -> None:
        node: Any = description
        for part in place[:-1]:
            node = node[part]
        del node[place[-1]]

    return change


#: what is done to the road-rail excavator, then: element, words in the message, value, words in `allowed`
REFUSED: dict[str, tuple[Change, str, str, Any, str | None]] = {
    "zero-length box": (
        put("solids", 3, "size_m", [4.5, 0, 0.7]), "solids[boom].size_m", "without length", [4.5, 0, 0.7], "above 0"),
    "negative box": (
        put("solids", 3, "size_m", [4.5, -1, 0.7]),
        "solids[boom].size_m", "without length", [4.5, -1, 0.7], "above 0"),
    "box in millimetres": (
        put("solids", 3, "size_m", 0, 4550), "solids[boom].size_m[0]", "too large", 4550, "100 or less"),
    "crossed limits": (
        put("joints", 1, "lower_deg", 80), "joints[boom].lower_deg", "limits are crossed", "80", "below 65"),
    "equal limits": (
        put("joints", 1, "lower_deg", 65), "joints[boom].lower_deg", "limits are crossed", "65", "below 65"),
    "home outside": (
        put("joints", 2, "home_deg", 0), "joints[stick].home_deg", "outside the limits", "0", "-150 to -30"),
    "limits of an endless joint": (
        put("joints", 0, "lower_deg", -90), "joints[swing].lower_deg", "turns without end", -90, None),
    "no limit": (drop("joints", 1, "upper_deg"), "joints[boom].upper_deg", "missing key", None, "a number"),
    "unknown key": (put("colour", "yellow"), "colour", "unknown key", None, "attachments"),
    "unknown key of a joint": (
        put("joints", 1, "speed_rpm", 9), "joints[boom].speed_rpm", "unknown key", None, "speed_positive_deg_s"),
    "unknown key of a row": (
        put("joints", 1, "dh", "a_mm", 5200), "joints[boom].dh.a_mm", "unknown key", None, "a_m"),
    "metres for a revolute joint": (
        put("joints", 1, "lower_m", 0), "joints[boom].lower_m", "unknown key", None, "lower_deg"),
    "missing key": (drop("title"), "title", "missing key", None, None),
    "missing type": (drop("joints", 1, "type"), "joints[boom].type", "missing key", None, "prismatic"),
    "unknown type": (
        put("joints", 1, "type", "screw"), "joints[boom].type", "unknown kind", "screw", "revolute, prismatic"),
    "unknown lever": (put("joints", 1, "lever", "pedal"), "joints[boom].lever", "unknown lever", "pedal", "right_y"),
    "lever twice": (
        put("joints", 1, "lever", "left_x"), "joints[boom].lever", "moves another joint", "left_x", "one joint each"),
    "lever sign": (put("joints", 1, "lever_sign", 2), "joints[boom].lever_sign", "unknown value", 2, "1 or -1"),
    "joint name twice": (put("joints", 1, "name", "swing"), "joints[swing].name", "used twice", "swing", "unique"),
    "link name twice": (put("joints", 1, "link", "cabin"), "joints[boom].link", "used twice", "cabin", "unique"),
    "link called undercarriage": (
        put("joints", 1, "link", "undercarriage"), "joints[boom].link", "used twice", "undercarriage", "unique"),
    "box name twice": (put("solids", 3, "name", "tail"), "solids[tail].name", "used twice", "tail", "unique"),
    "attachment's box name twice": (
        put("attachments", 1, "boxes", 0, "name", "boom"),
        "attachments[sleeper grab].boxes[boom].name", "used twice", "boom", "unique"),
    "attachment name twice": (
        put("attachments", 1, "name", "grading bucket"),
        "attachments[grading bucket].name", "used twice", "grading bucket", "unique"),
    "sensor name twice": (
        put("sensors", 1, "name", "antenna left"),
        "sensors[antenna left].name", "used twice", "antenna left", "unique"),
    "NaN": (put("joints", 1, "dh", "a_m", math.nan), "joints[boom].dh.a_m", "not a finite number", None, "finite"),
    "infinite": (put("joints", 1, "upper_deg", math.inf), "joints[boom].upper_deg", "finite", None, "finite"),
    "yes is no number": (put("joints", 1, "home_deg", True), "joints[boom].home_deg", "not a number", True, "number"),
    "words for a number": (
        put("joints", 1, "home_deg", "up"), "joints[boom].home_deg", "valid number", "up", None),
    "no speed": (
        put("joints", 1, "speed_negative_deg_s", 0), "joints[boom].speed_negative_deg_s", "too small", 0, "above 0"),
    "speed missing": (
        drop("joints", 1, "speed_negative_deg_s"), "joints[boom].speed_negative_deg_s", "missing key", None, None),
    "negative dead time": (
        put("joints", 1, "stopping_positive", "dead_time_s", -0.1),
        "joints[boom].stopping_positive.dead_time_s", "too small", -0.1, "0 or more"),
    "tolerance of the whole": (
        put("joints", 1, "stopping_positive", "tolerance_percent", 100),
        "joints[boom].stopping_positive.tolerance_percent", "too large", 100, "below 100"),
    "unknown link of a box": (put("solids", 2, "link", "cab"), "solids[tail].link", "unknown link", "cab", "cabin"),
    "unknown link of a sensor": (
        put("sensors", 0, "link", "cab"), "sensors[antenna left].link", "unknown link", "cab", "cabin"),
    "group of an unknown joint": (
        put("exclusive_groups", [["boom"], ["swing", "jib"]]),
        "exclusive_groups[1][1]", "unknown joint", "jib", "swing, boom"),
    "joint in two groups": (
        put("exclusive_groups", [["boom"], ["swing", "boom"]]),
        "exclusive_groups[1][1]", "in two groups", "boom", "one group"),
    "one group": (put("exclusive_groups", [["boom", "swing"]]), "exclusive_groups", "alone", None, "two groups"),
    "unknown contact": (
        put("allowed_contacts", [["boom", "mast"]]), "allowed_contacts[0][1]", "unknown box", "mast", "boom"),
    "contact of three": (
        put("allowed_contacts", [["boom", "tail", "stick"]]), "allowed_contacts[0]", "2 items", None, None),
    "neither row nor URDF": (
        drop("joints", 1, "dh"), "joints", "neither a row nor a URDF", None, "`dh` in every joint"),
    "row and URDF": (
        put("urdf", {"file": "a", "base_link": "b", "tip_link": "c"}),
        "joints", "both a URDF and a row", None, "`urdf`"),
    "no joints": (put("joints", []), "joints", "at least 1 item", None, None),
    "no boxes": (put("solids", []), "solids", "at least 1 item", None, None),
    "no attachments": (put("attachments", []), "attachments", "at least 1 item", None, None),
    "undercarriage of another kind": (
        put("undercarriage", "kind", "skids"), "undercarriage.kind", "unknown value", "skids", "'rail', 'tracks'"),
    "gauge of nothing": (put("undercarriage", "gauge_m", 0), "undercarriage.gauge_m", "too small", 0, "above 0"),
    "joints as a mapping": (put("joints", {"boom": 1}), "joints", "valid tuple", None, None),
    "joint as a word": (put("joints", 1, "boom"), "joints[1]", "dictionary", "boom", None),
    "two numbers": (
        put("solids", 0, "centre_m", [0, 1]), "solids[undercarriage].centre_m[2]", "missing key", None, None),
    "stretch with a revolute joint": (
        put("solids", 3, "stretch", {"joint": "boom", "axis": "x", "side": "positive"}),
        "solids[boom].stretch.joint", "not a prismatic joint", "boom", None),
    "stretch with an unknown joint": (
        put("solids", 3, "stretch", {"joint": "jib", "axis": "x", "side": "positive"}),
        "solids[boom].stretch.joint", "unknown joint", "jib", "boom"),
}  # fmt: skip


@pytest.mark.parametrize("fault", REFUSED)
def test_a_fault_is_named(tmp_path: Path, fault: str) -> None:
    change, element, words, value, allowed = REFUSED[fault]
    description = copy.deepcopy(RRE20)
    change(description)
    path = tmp_path / "machine.yaml"
    path.write_text(yaml.safe_dump(description, sort_keys=False))
    with pytest.raises(MachineError) as caught:
        load_machine(path)
    error = caught.value
    assert isinstance(error, InputError)
    assert error.element == element
    assert words in error.message
    if value is not None:
        assert error.value == value
    if allowed is not None:
        assert error.allowed is not None and allowed in error.allowed
    assert error.file == str(path)
    if "missing key" not in words:  # what is not there has the line of what it is missing from
        assert error.line is not None
        shown = path.read_text().splitlines()[error.line - 1]
        assert (
            element.split(".")[-1].split("[")[0] in shown or str(value) in shown or shown.lstrip().startswith("- - ")
        )
    assert "\n" not in str(error)


TELESCOPE: dict[str, Any] = {
    "title": "telescope",
    "undercarriage": {"kind": "wheels", "gauge_m": 2},
    "joints": [
        {
            "name": "reach",
            "type": "prismatic",
            "lower_m": -0.5,
            "upper_m": 1,
            "home_m": 0,
            "speed_positive_m_s": 1,
            "speed_negative_m_s": 1,
            "dh": {"a_m": 0, "alpha_deg": 0, "d_m": 1},
        }
    ],
    "solids": [
        {
            "name": "arm",
            "link": "reach",
            "centre_m": [0, 0, 0],
            "size_m": [0.4, 0.4, 2],
            "stretch": {"joint": "reach", "axis": "z", "side": "negative"},
        }
    ],
    "attachments": [{"name": "hook", "tool": {}, "boxes": []}],
}


def test_boxes_that_stretch() -> None:
    assert machine_from(TELESCOPE).solids[0].stretch is not None
    short = copy.deepcopy(TELESCOPE)
    short["solids"][0]["size_m"] = [0.4, 0.4, 0.5]
    with pytest.raises(MachineError, match=r"solids\[arm\].size_m: no length left"):
        machine_from(short)
    two = copy.deepcopy(TELESCOPE)
    two["attachments"][0]["boxes"] = [{"name": "hook", "centre_m": [0, 0, 1], "size_m": [1, 1, 1]}]
    with pytest.raises(MachineError, match=r"solids\[arm\].stretch: another box on a link that stretches"):
        machine_from(two)
    crossed = copy.deepcopy(TELESCOPE)
    crossed["joints"][0]["upper_m"] = -1
    with pytest.raises(MachineError, match=r"joints\[reach\].lower_m: limits are crossed"):
        machine_from(crossed)


FILES: dict[str, tuple[bytes, str]] = {
    "empty": (b"", "no machine description.*found nothing"),
    "only comments": (b"# nothing\n", "no machine description"),
    "a list": (b"- 1\n- 2\n", "no machine description.*found list"),
    "a word": (b"excavator", "no machine description.*found str"),
    "bad indentation": (b"title: a\n joints: 1\n", r"machine.yaml:2: bad YAML"),
    "unclosed": (b"title: [a, b\n", "bad YAML"),
    "key twice": (b"title: a\nsource: b\ntitle: c\n", r"machine.yaml:3: bad YAML: key title appears twice"),
    "alias": (b"title: &a x\nsource: *a\n", r"machine.yaml:2: bad YAML: aliases"),
    "list as key": (b"? [a, b]\n: 1\n", "bad YAML"),
    "python object": (b"title: !!python/object:os.system {}\n", "bad YAML"),
    "binary": (b"\x00\xff\xfe\x01", "bad YAML"),
    "not UTF-8": (b"title: \xff\xff", "bad YAML"),
    "deep": (b"[" * 20000, "bad YAML"),
    "bomb": (b"a: &a [x,x]\nb: &b [*a,*a]\nc: &c [*b,*b]\n", "aliases"),
    "too large": (b"#" * 1_000_001, "no machine description"),
    "not a date": (b"title: 2024-13-45\n", "bad YAML: month"),
    "two documents": (b"title: a\n---\ntitle: b\n", "bad YAML"),
}


@pytest.mark.parametrize("fault", FILES)
def test_a_file_that_is_no_description(tmp_path: Path, fault: str) -> None:
    content, message = FILES[fault]
    path = tmp_path / "machine.yaml"
    path.write_bytes(content)
    with pytest.raises(MachineError, match=message) as caught:
        load_machine(path)
    assert caught.value.file == str(path)
    assert "\n" not in str(caught.value)


def test_a_file_that_is_not_there(tmp_path: Path) -> None:
    for path in (tmp_path / "missing.yaml", str(tmp_path / "missing.yaml"), tmp_path, "a\x00b.yaml"):
        with pytest.raises(MachineError, match="cannot read"):
            load_machine(path)


def test_an_unknown_machine_or_attachment() -> None:
    with pytest.raises(
        MachineError, match=r"did you mean rre20\?.*found rre-20; allowed: brokk5, rre20, sun-a, sun-b"
    ):
        load_machine("rre-20")
    with pytest.raises(MachineError, match=r"unknown machine \(found zzz"):
        load_machine("zzz")
    with pytest.raises(
        MachineError,
        match=r"unknown attachment \(found ripper; allowed: grading bucket, sleeper grab, ditching bucket\)",
    ):
        load_machine("rre20", "ripper")


def test_a_folder_and_a_name_mean_a_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "mine.yml").write_text((SHIPPED / "sun-a.yaml").read_text())
    monkeypatch.chdir(tmp_path)
    assert load_machine("mine.yml").name == "mine"
    assert load_machine(str(tmp_path / "mine.yml")).joint_names == load_machine("sun-a").joint_names


def test_the_schema_knows_every_key() -> None:
    schema = json_schema()
    assert set(schema["properties"]) == set(MachineDescription.model_fields)
    assert schema["additionalProperties"] is False
    assert all(part["additionalProperties"] is False for part in schema["$defs"].values())
    revolute = schema["$defs"]["RevoluteJoint"]["properties"]
    assert "left_x" in str(revolute["lever"]) and "speed_positive_deg_s" in revolute


def places(node: Any, at: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """Every path in a description."""
    inner = node.items() if isinstance(node, dict) else enumerate(node) if isinstance(node, list) else ()
    return [*([at] if at else []), *(place for key, value in inner for place in places(value, (*at, key)))]


JUNK = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(-(10**400), 10**400),
    st.floats(),
    st.text(max_size=20),
    st.sampled_from([[], {}, [[]], {"name": 3}, [1, 2, 3], "left_x", "undercarriage", "boom", b"x", 1e308, -1e-308]),
)


@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(st.sampled_from(places(BROKK5)), JUNK, st.booleans())
def test_any_value_put_anywhere_is_used_or_refused(place: tuple[Any, ...], junk: Any, remove: bool) -> None:
    description = copy.deepcopy(BROKK5)
    (drop(*place) if remove else put(*place, junk))(description)
    try:
        machine = machine_from(description)
    except MachineError as error:
        if len(str(error)) > 2000 or not error.element:
            pytest.fail(f"unreadable message {error}")
    else:
        assert isinstance(machine, MachineModel)
        assert all(math.isfinite(value) for value in machine.forward(machine.home).T_machine_links.ravel())


@settings(max_examples=200, deadline=None)
@given(st.one_of(st.binary(max_size=60), st.text(alphabet="{}[]:,&*!|>-?#%@ abtitle\n\t'\"0123.", max_size=60)))
def test_any_bytes_are_refused(tmp_path_factory: pytest.TempPathFactory, content: bytes | str) -> None:
    path = tmp_path_factory.getbasetemp() / "fuzzed.yaml"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(MachineError):
        load_machine(path)
