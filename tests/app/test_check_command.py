"""`workgauge check`: compared, logged, and asked for before a machine is armed."""

import json
from pathlib import Path

import numpy as np
import pytest
import yaml

from workgauge.app import check_file
from workgauge.app.check_file import append_check, newest_check, refuse_unchecked
from workgauge.geodesy.crs import ProjectedCrs
from workgauge.geodesy.frame import SiteFrame
from workgauge.machine.load import description_path, load_machine
from workgauge.positioning.check_log import read_line
from workgauge.sim.sensors.kit import SensorKit
from workgauge.values.errors import InputError

POINT = "25500008,6700100,50"
HOUR_NS = 3_600_000_000_000


def check(cli, *more: object, tool: str = "25500008.01,6700100.0,50.01", sigma: object = 12):  # type: ignore[no-untyped-def]
    return cli.workgauge("check", "--machine", "rre20", "--tool", tool, "--sigma-mm", sigma, *more)


def test_a_good_check_passes_and_is_logged(cli, tmp_path: Path) -> None:
    log = tmp_path / "checks.jsonl"
    data = check(cli, "--point", POINT, "--heading-deg", 90, "--file", log, "--json").data
    assert data["passed"] and data["why"] == [] and data["machine"] == "rre20"
    assert (data["along_m"], data["left_m"], data["up_m"]) == pytest.approx((0.01, 0.0, 0.01), abs=1e-6)
    assert json.loads(log.read_text()) == data
    answer = check(cli, "--point", POINT, "--file", log)
    assert answer.code == 0 and "Check passed" in answer.out and len(log.read_text().splitlines()) == 2


def test_a_bad_check_is_logged_too_and_says_so_in_its_exit_code(cli, tmp_path: Path) -> None:
    log = tmp_path / "checks.jsonl"
    answer = check(cli, "--point", POINT, "--file", log, tool="25500008.2,6700100,50")
    assert answer.code == 3 and "must not work" in answer.out and "200 mm from the point" in answer.out
    (line,) = log.read_text().splitlines()
    assert not read_line(line).passed  # type: ignore[union-attr]
    assert check(cli, "--point", POINT, "--json", tool="25500008.2,6700100,50").code == 3


def test_a_point_by_its_name_in_the_sites_files(cli, write) -> None:
    site = write(cli.document(cli.alignment(cli.STRAIGHT), cli.POLE))
    data = check(cli, "--point-name", "P7", "--site", site, "--json").data
    assert data["point_name"] == "P7" and data["point"] == {"e": 25500008, "n": 6700100, "h": 50}
    cli.refused(check(cli, "--point-name", "P8", "--site", site), "no such point", "P7")
    flat = write(cli.document(cli.alignment(cli.STRAIGHT), cli.POLE.replace(" 50<", "<")), "flat.xml")
    cli.refused(check(cli, "--point-name", "P7", "--site", flat), "no height")
    other = write(cli.document(cli.POLE.replace(" 50<", " 51<")), "other.xml")
    cli.refused(check(cli, "--point-name", "P7", "--site", site, other), "several points")


@pytest.mark.parametrize(
    "arguments",
    [
        [],
        ["--point", POINT, "--point-name", "P7"],
        ["--point-name", "P7"],
        ["--point", "1,2"],
        ["--point", "1,2,nan"],
        ["--point", "a,b,c"],
        ["--point", POINT, "--point-sigma-mm", "-1"],
        ["--point", POINT, "--heading-deg", "nan"],
        ["--point", POINT, "--sigma-mm", "0"],
    ],
)
def test_options_that_cannot_be_used_show_the_usage(cli, arguments: list[str]) -> None:
    assert check(cli, *arguments).code == 2


def test_a_check_that_cannot_be_written_is_refused(cli, tmp_path: Path) -> None:
    cli.refused(check(cli, "--point", POINT, "--file", tmp_path / "no" / "checks"), "cannot write the check")
    cli.refused(check(cli, "--point", POINT, "--file", tmp_path), "cannot write the check")


def test_an_interrupted_log_goes_on_with_the_next_line(cli, tmp_path: Path) -> None:
    log = tmp_path / "checks.jsonl"
    check(cli, "--point", POINT, "--file", log)
    whole = log.read_bytes()
    log.write_bytes(whole + whole[:40])
    check(cli, "--point", POINT, "--file", log, tool="25500009,6700100,50")
    lines = log.read_text().splitlines()
    assert len(lines) == 3 and read_line(lines[1]) is None and lines[0] == whole.decode().rstrip("\n")
    found = newest_check(log, load_machine("rre20"))
    assert found is not None and not found.passed


def requiring(tmp_path: Path) -> Path:
    described = yaml.safe_load(description_path("rre20").read_text())
    described["positioning"]["thresholds"] = {"check_required": True, "check_hours": 8}
    file = tmp_path / "rre20.yaml"
    file.write_text(yaml.safe_dump(described))
    return file


def test_a_machine_that_asks_for_a_check_is_not_armed_without_one(
    cli, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    machine, log = requiring(tmp_path), tmp_path / "checks.jsonl"
    run = ("run", "--scenario", "pole-approach", "--headless", "--machine", machine)
    cli.refused(cli.workgauge(*run), "asks for a start-of-shift check", "--check FILE")
    cli.refused(cli.workgauge(*run, "--check", log), "cannot read the checks")
    log.write_text("{}\n")
    cli.refused(cli.workgauge(*run, "--check", log), "no check in this file")
    arguments = ("check", "--machine", machine, "--sigma-mm", 12, "--point", POINT, "--file", log)
    cli.workgauge(*arguments, "--tool", "25500009,6700100,50")
    cli.refused(cli.workgauge(*run, "--check", log), "not armed: the check failed", "1000 mm")
    assert cli.workgauge(*arguments, "--tool", POINT).code == 0
    model = load_machine(machine)
    assert refuse_unchecked(model, log)
    later = check_file.utc_now_ns() + 9 * HOUR_NS
    monkeypatch.setattr(check_file, "utc_now_ns", lambda: later)
    cli.refused(cli.workgauge(*run, "--check", log), "9.0 h old", "8 h")


def test_a_check_of_another_attachment_does_not_arm(cli, tmp_path: Path) -> None:
    log = tmp_path / "checks.jsonl"
    check(cli, "--point", POINT, "--file", log)
    assert refuse_unchecked(load_machine("rre20"), log)
    with pytest.raises(InputError, match="this is rre20 with sleeper grab"):
        refuse_unchecked(load_machine("rre20", "sleeper grab"), log)
    assert not refuse_unchecked(load_machine("rre20"), None)
    result = newest_check(log, load_machine("rre20"))
    assert result is not None
    with pytest.raises(InputError, match="cannot write"):
        append_check(Path("\0"), result)


POSTURE = {"swing": 30.0, "boom": 10.0, "stick": -80.0}


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> tuple[list[str], np.ndarray]:
    """Return two receivers' logs of a machine that stands level with its tool on a point, and that point."""
    machine, crs = load_machine("rre20"), ProjectedCrs.from_epsg(3879)
    frame = SiteFrame(crs, np.array([25_500_000.0, 6_700_100.0, 20.0]))
    q = np.array(machine.home)
    for name, degrees in POSTURE.items():
        q[machine.joint_names.index(name)] = np.radians(degrees)
    kit = SensorKit(machine, crs, frame, seed=4)
    written: dict[str, bytes] = {}
    for k in range(301):
        kit.advance(k * 10_000_000, q, np.eye(4))
        for chunk in kit.read(k * 10_000_000):
            written[chunk.port] = written.get(chunk.port, b"") + chunk.data
    folder = tmp_path_factory.mktemp("logs")
    given = []
    for port in ("gnss-left", "gnss-right"):
        (folder / port).write_bytes(written[port])
        given += ["--gnss", f"{port}={folder / port}"]
    return given, frame.to_absolute(machine.tool_pose(machine.forward(q))[:3, 3])


def test_the_tool_is_where_the_machines_own_logs_have_it(cli, logs, tmp_path: Path) -> None:
    given, point = logs
    posture = [text for name, degrees in POSTURE.items() for text in ("--posture-deg", f"{name}={degrees}")]
    common = ("check", "--machine", "rre20", *given, "--epsg", 3879, *posture, "--point-sigma-mm", 2)
    good = cli.workgauge(*common, "--point", ",".join(f"{v:.4f}" for v in point), "--json")
    assert good.data["passed"], good.data["why"]
    assert 0 < good.data["distance_m"] < 0.05 and good.data["sigmas"] < 4 and 0.005 < good.data["sigma_m"] < 0.08
    off = point + np.array([0.0, 0.0, 0.12])
    bad = cli.workgauge(*common, "--point", ",".join(f"{v:.4f}" for v in off), "--file", tmp_path / "checks")
    assert bad.code == 3 and "from the point" in bad.out and "stand level" in bad.err
    wrong = cli.workgauge(*common, "--posture-deg", "boom=14", "--point", ",".join(f"{v:.4f}" for v in point))
    assert wrong.code == 3  # 4 degrees of boom are more than 0.3 m at the tool


def test_logs_that_cannot_be_used_are_refused(cli, logs, tmp_path: Path) -> None:
    given, _ = logs
    base = ("check", "--machine", "rre20", "--point", POINT)
    assert cli.workgauge(*base, *given).code == 2  # no coordinate system
    assert cli.workgauge(*base, *given, "--tool", POINT, "--sigma-mm", 5, "--epsg", 3879).code == 2
    cli.refused(cli.workgauge(*base, *given, "--epsg", 3879, "--posture-deg", "arm=3"), "no such joint", "swing")
    assert cli.workgauge(*base, *given, "--epsg", 3879, "--posture-deg", "boom").code == 2
    cli.refused(cli.workgauge(*base, "--gnss", tmp_path / "none", "--epsg", 3879), "no such file")
    cli.refused(cli.workgauge(*base, *given[:2], "--epsg", 3879), "no position to check")
