"""`workgauge measure-up`: from a table of touches to an attachment's entry, or to one clear refusal."""

import math
from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from workgauge.app.measure_up_command import parse_pose
from workgauge.machine.load import load_machine
from workgauge.machine.touch_file import read_touches
from workgauge.values.errors import MachineError
from workgauge.values.transforms import apply

MACHINE = load_machine("rre20")
TIP = np.array([0.10, 0.02, 1.55])
JOINTS = [f"{name}_deg" for name in MACHINE.joint_names]
POSE = "25500100,6700200,45.5,123,2,-1"


def rows(many: int = 6, site: bool = False, noise_m: float = 0.002) -> list[list[float]]:
    """Return rows of joint angles in degrees and the tip's place."""
    rng = np.random.default_rng(8)
    out = []
    for k in range(many):
        degrees = [10 * k - 30, 20 + 5 * k, -70 - 5 * k, -60 + 8 * k, 6 * k - 15, 20 * k - 50]
        T = MACHINE.forward(np.radians(degrees)).T_machine_links[-1]
        place = apply(T, TIP) + noise_m * rng.standard_normal(3)
        if site:
            place = apply(parse_pose(POSE), place)
        out.append([*degrees, *place])
    return out


def table(path: Path, header: list[str], body: list[list[float]], separator: str = ",", decimal: str = ".") -> Path:
    text = [separator.join(header)]
    text += [separator.join(f"{v:.4f}".replace(".", decimal) for v in row) for row in body]
    path.write_text("\n".join(text) + "\n", encoding="utf-8")
    return path


@pytest.fixture
def touches(tmp_path: Path) -> Path:
    return table(tmp_path / "touches.csv", [*JOINTS, "x_m", "y_m", "z_m"], rows())


def measure(cli, file: Path, *more: object, attachment: str = "trenching bucket"):  # type: ignore[no-untyped-def]
    return cli.workgauge("measure-up", file, "--machine", "rre20", "--attachment", attachment, *more)


def test_the_tool_is_found_and_its_entry_printed(cli, touches: Path) -> None:
    data = measure(cli, touches, "--json").data
    assert data["attachment"]["tool"]["position_m"] == pytest.approx(TIP.tolist(), abs=0.012)
    assert data["attachment"]["name"] == "trenching bucket" and data["redundancy"] == 15
    assert 0 < data["tolerance_m"] < 0.02 and len(data["residuals_m"]) == 6 and data["file"] is None
    answer = measure(cli, touches)
    assert answer.code == 0 and "tolerance" in answer.out and "has no boxes" in answer.err
    pasted = answer.out[answer.out.index("attachments:") :]
    entry = yaml.safe_load(pasted)["attachments"][0]
    assert entry == data["attachment"]


def test_places_in_the_sites_coordinates_give_the_same(cli, touches: Path, tmp_path: Path) -> None:
    surveyed = table(tmp_path / "site.csv", [*JOINTS, "e_m", "n_m", "h_m"], rows(site=True))
    here = measure(cli, touches, "--json").data
    there = measure(cli, surveyed, "--pose", POSE, "--json").data
    assert there["attachment"]["tool"]["position_m"] == pytest.approx(
        here["attachment"]["tool"]["position_m"], abs=3e-4
    )
    cli.refused(measure(cli, surveyed), "site's coordinates", "--pose")


def test_a_spreadsheet_of_another_country_reads_alike(tmp_path: Path) -> None:
    header = ["note", *JOINTS, "x_m", "y_m", "z_m"]
    plain = read_touches(table(tmp_path / "a.csv", header[1:], rows()), MACHINE)
    for k, (separator, decimal) in enumerate([(";", ","), (";", "."), ("\t", ","), (",", ".")]):
        file = tmp_path / f"{k}.csv"
        body = [[1.0, *row] for row in rows()]
        table(file, header, body, separator, decimal)
        file.write_bytes(b"\xef\xbb\xbf" + file.read_bytes().replace(b"\n", b"\r\n"))
        for one, other in zip(plain, read_touches(file, MACHINE), strict=True):
            assert (one.q == other.q).all() and (one.point == other.point).all()


def test_a_machine_file_is_written_whole_and_loads(cli, touches: Path, tmp_path: Path) -> None:
    out = tmp_path / "ours.yaml"
    data = measure(cli, touches, "--out", out, "--json", attachment="grading bucket").data
    machine = load_machine(out)
    assert machine.attachment == "grading bucket" and data["file"] == str(out)
    assert machine.T_link_tool[:3, 3] == pytest.approx(data["attachment"]["tool"]["position_m"])
    assert machine.tool_tolerance_m >= data["tolerance_m"] and machine.attachments == MACHINE.attachments
    assert [solid.name for solid in machine.solids] == [solid.name for solid in MACHINE.solids]
    assert sorted(file.name for file in tmp_path.iterdir()) == ["ours.yaml", "touches.csv"]
    before = out.read_bytes()
    cli.refused(measure(cli, touches, "--out", out), "exists already")
    assert out.read_bytes() == before


def test_an_attachment_listed_without_a_tool_can_be_measured_up_and_then_mounted(
    cli, touches: Path, tmp_path: Path
) -> None:
    described = yaml.safe_load(Path(str(_shipped())).read_text())
    described["attachments"].insert(0, {"name": "hammer", "boxes": [], "mass_kg": 800})
    file = tmp_path / "site-machine.yaml"
    file.write_text(yaml.safe_dump(described))
    with pytest.raises(MachineError, match="hammer is not measured up"):
        load_machine(file)
    out = tmp_path / "measured.yaml"
    answer = cli.workgauge("measure-up", touches, "--machine", file, "--attachment", "hammer", "--out", out)
    assert answer.code == 0, answer.err
    assert load_machine(out, "hammer").attachment == "hammer"


def _shipped() -> Path:
    from workgauge.machine.load import description_path

    return description_path("rre20")


def test_one_point_touched_turning_about_one_axis_is_refused(cli, tmp_path: Path) -> None:
    body = [[0, 30 + 3 * k, -70, -60 + 12 * k, 0, 0] for k in range(6)]
    file = table(tmp_path / "same.csv", JOINTS, body)
    cli.refused(measure(cli, file), "touches", "about another axis")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", ["nothing"]),
        ("a,b\n1,2\n", ["column is missing", "swing_deg"]),
        (",".join(JOINTS[:-1]) + "\n", ["rotate_deg"]),
        (",".join([*JOINTS, "boom_deg"]) + "\n", ["twice", "boom_deg"]),
        (",".join([*JOINTS, "x_m"]) + "\n", ["not a place of the tip"]),
        (",".join([*JOINTS, "x_m", "y_m", "z_m", "e_m", "n_m", "h_m"]) + "\n", ["not a place of the tip"]),
        (",".join(JOINTS) + "\n1,2,3,4,5\n", [":2:", "number of cells"]),
        (",".join(JOINTS) + "\n1,2,3,4,5,six\n", [":2: rotate_deg", "six"]),
        (",".join(JOINTS) + "\n1,2,3,4,5,nan\n", [":2: rotate_deg", "not a number"]),
        (",".join(JOINTS) + "\n1,2,3,4,5,6\n", ["too few touches", "4 or more"]),
        ('"', ["column is missing|no table"]),
    ],
)
def test_what_is_no_table_of_touches_is_refused(cli, tmp_path: Path, text: str, words: list[str]) -> None:
    file = tmp_path / "touches.csv"
    file.write_text(text)
    cli.refused(measure(cli, file, "--out", tmp_path / "out.yaml"), *words)
    assert not (tmp_path / "out.yaml").exists()


def test_other_bad_input_is_refused(cli, touches: Path, tmp_path: Path) -> None:
    cli.refused(measure(cli, tmp_path / "none.csv"), "cannot read the touches")
    cli.refused(measure(cli, touches, "--sigma-mm", 0), "never exact")
    cli.refused(cli.workgauge("measure-up", touches, "--machine", "rre21", "--attachment", "a"), "unknown machine")
    cli.refused(measure(cli, touches, "--out", tmp_path / "no" / "out.yaml"), "cannot write")
    binary = tmp_path / "binary.csv"
    binary.write_bytes(bytes(range(256)))
    cli.refused(measure(cli, binary), "not text")
    assert measure(cli, touches, "--pose", "1,2,3").code == 2


@settings(max_examples=150, suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
@given(st.binary(max_size=200) | st.text(alphabet=';,\t\n"swing_deg0123.', max_size=200).map(str.encode))
def test_any_file_is_touches_or_refused(tmp_path: Path, data: bytes) -> None:
    file = tmp_path / "any.csv"
    file.write_bytes(data)
    with pytest.raises(MachineError):
        read_touches(file, MACHINE)


def test_a_pose_is_where_it_says() -> None:
    T = parse_pose("10,20,30,90,5,0")
    assert T[:3, 3] == pytest.approx([10, 20, 30])
    assert T[:3, 0] == pytest.approx([math.cos(math.radians(5)), 0, -math.sin(math.radians(5))])
