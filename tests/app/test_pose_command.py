"""`workgauge pose`: what it says of a small log, how it refuses what is none, what it writes."""

import json
import math
import os
import random
import struct
from pathlib import Path

import numpy as np
import pytest

from workgauge.geodesy.crs import ProjectedCrs

KEYS = {"t", "lat_deg", "lon_deg", "h_m", "e", "n", "z", "quality", "sigma_m", "heading_deg", "health"}
EPSG = 3879


def nmea(body: str) -> bytes:
    """Return a sentence with its check sum, made here and not by the product."""
    check = 0
    for byte in body.encode():
        check ^= byte
    return f"${body}*{check:02X}\r\n".encode()


def gga(t: float, lat: float, lon: float, quality: int = 4, height: float = 25.0, separation: float = 18.0) -> bytes:
    hms = f"{int(t // 3600):02d}{int(t % 3600 // 60):02d}{t % 60:05.2f}"
    sides = f"{int(lat):02d}{lat % 1 * 60:011.8f},N,{int(lon):03d}{lon % 1 * 60:011.8f},E"
    return nmea(f"GNGGA,{hms},{sides},{quality},14,0.8,{height:.3f},M,{separation:.3f},M,1.0,0001")


def log_of(epochs: int = 30, quality: int = 4) -> bytes:
    """A receiver at 10 Hz that drives north-east, with its date, its error and a heading."""
    out = b""
    for i in range(epochs):
        t = 40_000 + 0.1 * i
        out += gga(t, 60.2 + 1e-6 * i, 24.9 + 2e-6 * i, quality)
        out += nmea(f"GNZDA,{int(t // 3600):02d}{int(t % 3600 // 60):02d}{t % 60:05.2f},07,09,2024,00,00")
        out += nmea(f"GNGST,{int(t // 3600):02d}{int(t % 3600 // 60):02d}{t % 60:05.2f},0.02,,,,0.011,0.012,0.021")
        out += nmea("GNHDT,45.25,T")
    return out


@pytest.fixture
def log(tmp_path: Path) -> Path:
    path = tmp_path / "drive.nmea"
    path.write_bytes(log_of())
    return path


def test_epochs_have_the_documented_keys_and_the_right_numbers(cli, log):
    told = cli.workgauge("pose", log, "--epsg", EPSG, "--json").data
    assert told["sentences"] == {"good": 120, "bad": 0, "unknown": 0}
    assert (told["rejected"], told["time"], told["crs"]["epsg"]) == ({}, "utc", EPSG)
    assert len(told["epochs"]) == 30
    assert all(set(epoch) >= KEYS for epoch in told["epochs"])
    first, last = told["epochs"][0], told["epochs"][-1]
    assert first["t"] == pytest.approx(1_725_667_200 + 40_000)
    assert last["t"] == pytest.approx(1_725_667_200 + 40_002.9)
    assert (first["lat_deg"], first["lon_deg"]) == (pytest.approx(60.2, abs=1e-9), pytest.approx(24.9, abs=1e-9))
    assert (first["h_m"], first["z"], first["quality"]) == (43.0, 25.0, 4)
    assert first["sigma_m"] == [0.012, 0.011, 0.021] and first["sigma_stated"]
    crs = ProjectedCrs.from_epsg(EPSG)
    e, n = crs.from_geodetic(math.radians(60.2), math.radians(24.9))
    assert (first["e"], first["n"]) == (pytest.approx(float(e), abs=1e-4), pytest.approx(float(n), abs=1e-4))
    turned = 45.25 - math.degrees(float(crs.convergence(e, n)))
    assert first["heading_deg"] == pytest.approx(turned, abs=1e-5)
    assert first["heading_true_deg"] == 45.25
    assert first["health"] == "stop" and last["health"] == "fixed"
    assert "separation" in told["height"]
    assert told["warnings"] == []


def test_without_a_date_times_are_of_the_day(cli, tmp_path):
    path = tmp_path / "log"
    path.write_bytes(gga(40_000.0, 60.2, 24.9) + gga(40_000.1, 60.2, 24.9))
    told = cli.workgauge("pose", path, "--epsg", EPSG, "--json").data
    assert told["time"] == "day"
    assert [epoch["t"] for epoch in told["epochs"]] == [40_000.0, 40_000.1]
    unknown = told["epochs"][0]
    assert (
        unknown["sigma_m"] == [0.015, 0.015, 0.025] and not unknown["sigma_stated"] and unknown["heading_deg"] is None
    )


def test_junk_between_sentences_is_counted_and_passed_over(cli, tmp_path):
    path = tmp_path / "log"
    noise = random.Random(7).randbytes(500).replace(b"$", b".").replace(b"\xb5", b".").replace(b"*", b".")
    broken = gga(40_000.1, 60.3, 24.9).replace(b"GNGGA", b"GNGGB")
    path.write_bytes(noise + log_of(3) + noise + broken + gga(40_000.4, 60.2, 24.9)[:-5] + b"\r\n" + log_of(3))
    told = cli.workgauge("pose", path, "--epsg", EPSG, "--json").data
    assert told["sentences"]["bad"] == sum(told["rejected"].values()) >= 2
    assert all(abs(epoch["lat_deg"] - 60.2) < 1e-4 for epoch in told["epochs"] if epoch["lat_deg"] is not None)


def test_heights_by_constant_and_by_grid(cli, log, tmp_path):
    constant = cli.workgauge("pose", log, "--epsg", EPSG, "--geoid-separation", 17.5, "--json").data
    assert constant["epochs"][0]["z"] == pytest.approx(25.5)
    assert "17.5 m" in constant["height"]
    grid = tmp_path / "geoid.gtx"
    heights = np.full((2, 2), 20.0, dtype=">f4")
    grid.write_bytes(struct.pack(">ddddii", 60.0, 24.0, 1.0, 1.0, 2, 2) + heights.tobytes())
    by_grid = cli.workgauge("pose", log, "--epsg", EPSG, "--geoid-grid", grid, "--json").data
    assert by_grid["epochs"][0]["z"] == pytest.approx(23.0, abs=1e-4)
    assert "geoid.gtx" in by_grid["height"]


def test_a_wrong_system_is_doubted(cli, log):
    told = cli.workgauge("pose", log, "--epsg", 25832, "--json").data
    assert any("outside" in text and "25832" in text for text in told["warnings"])
    shifted = cli.workgauge("pose", log, "--epsg", 2392, "--json").data
    assert any("datum" in text for text in shifted["warnings"])
    assert "warning" in cli.workgauge("pose", log, "--epsg", 25832).err


def test_heights_that_no_sentence_gives_are_warned_of(cli, tmp_path):
    path = tmp_path / "low.nmea"
    path.write_bytes(nmea("GPRMC,100000,A,6012.0,N,02454.0,E,0.0,,010126,,,A"))
    told = cli.workgauge("pose", path, "--epsg", EPSG, "--json").data
    assert told["epochs"][0]["z"] is None
    assert any("no height" in warning for warning in told["warnings"])


def test_for_people(cli, log):
    answer = cli.workgauge("pose", log, "--epsg", EPSG)
    assert answer.code == 0
    for words in ("RTK fixed", "120 good", "GK25FIN", "separation", "30"):
        assert words in answer.out


def test_the_report_is_one_page_and_the_object(cli, log, tmp_path):
    folder = tmp_path / "made" / "here"
    told = cli.workgauge("pose", log, "--epsg", EPSG, "--report", folder, "--json").data
    assert sorted(file.name for file in folder.iterdir()) == ["pose.json", "report.html"]
    assert json.loads((folder / "pose.json").read_text("utf-8")) == told
    page = (folder / "report.html").read_text("utf-8")
    assert page.count("<svg") >= 4
    assert "http" not in page.replace("http-equiv", "")
    assert "RTK fixed: 30" in page


def test_two_logs_are_two_streams(cli, log, tmp_path):
    other = tmp_path / "other.nmea"
    other.write_bytes(log_of(5, quality=5))
    told = cli.workgauge("pose", log, f"rover={other}", "--epsg", EPSG, "--json").data
    assert [epoch["source"] for epoch in told["epochs"]] == ["gnss/GN"] * 30 + ["rover/GN"] * 5
    assert told["files"] == [str(log), str(other)]


@pytest.mark.parametrize(
    ("what", "word"),
    [
        ("missing", "no such file"),
        ("folder", "directory"),
        ("empty", "empty"),
        ("junk", "sentence"),
        ("text", "sentence"),
        ("no position", "position"),
        ("device", "regular"),
        ("huge", "large"),
        ("zeros", "sentence"),
    ],
)
def test_what_is_no_log_is_refused_in_one_line(cli, tmp_path, what, word):
    path, report = tmp_path / "log", tmp_path / "report"
    if what == "folder":
        path.mkdir()
    elif what == "device":
        path = Path("/dev/zero")
    elif what in ("huge", "zeros"):
        with path.open("wb") as file:
            file.truncate(1 << 40 if what == "huge" else 1 << 26)
    elif what != "missing":
        content = {
            "empty": b"",
            "junk": random.Random(3).randbytes(200_000),
            "text": b"machine: rre20\n" * 50,
            "no position": nmea("GNHDT,45.25,T") * 3,
        }
        path.write_bytes(content[what])
    cli.refused(cli.workgauge("pose", path, "--epsg", EPSG, "--report", report, "--json"), word, path.name)
    assert not report.exists()


@pytest.mark.skipif(os.geteuid() == 0, reason="root may read everything")
def test_a_log_that_may_not_be_read(cli, log):
    log.chmod(0)
    cli.refused(cli.workgauge("pose", log, "--epsg", EPSG), "drive.nmea")


@pytest.mark.parametrize("epsg", ["4326", "999999", "-1"])
def test_a_system_that_is_none_is_refused(cli, log, epsg):
    cli.refused(cli.workgauge("pose", log, "--epsg", epsg), epsg, "allowed")


@pytest.mark.parametrize(
    "rest", [(), ("--epsg", "x"), ("--epsg", "3879", "--geoid-separation", "1", "--geoid-grid", "g")]
)
def test_wrong_options(cli, log, rest):
    answer = cli.workgauge("pose", log, *rest)
    assert answer.code == 2
    assert answer.out == ""
    assert "Traceback" not in answer.err


def test_a_missing_grid_is_named(cli, log):
    cli.refused(cli.workgauge("pose", log, "--epsg", EPSG, "--geoid-grid", "fi_nls_n2000.tif"), "fi_nls_n2000.tif")


def test_a_report_that_cannot_be_written_leaves_nothing(cli, log, tmp_path):
    in_the_way = tmp_path / "file"
    in_the_way.write_text("x")
    cli.refused(cli.workgauge("pose", log, "--epsg", EPSG, "--report", in_the_way / "report"), "report")
