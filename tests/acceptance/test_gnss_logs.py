"""Receivers' logs by other people through `workgauge pose`, against what gpsd decoded from them.

A `.chk` file holds gpsd's reports as JSON lines: TPV with position and status, ATT with the heading.
"""

import json
import math
import re
import subprocess
import sys
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).parents[2]
GNSS = ROOT.parent / "shared" / "data" / "gnss"
PROGRAM = Path(sys.executable).with_name("workgauge")

pytestmark = pytest.mark.skipif(not GNSS.is_dir(), reason="third-party files are not at ../shared/data/gnss")

CHECKED = sorted(path.name.removesuffix(".chk") for path in (GNSS / "gpsd").glob("*.chk")) if GNSS.is_dir() else []

#: gpsd's status to the GGA's quality: differential, RTK fixed, RTK float.
STATUS = {2: 2, 3: 4, 4: 5}

#: UTM zone of each log's place.
ZONES = {
    "ac12_binary.log": 32616,
    "hemi.log": 32619,
    "nmea-fuzzy-cases.log": 32615,
    "nmea-rtk.log": 32615,
    "saab-r4.log": 32629,
    "ublox-f9p-hpnmea.log": 32610,
    "ublox-neo-m8p.log": 32633,
    "ublox-zed-f9p-rtk.log": 32633,
}


def pose(path: Path, epsg: int) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [PROGRAM, "pose", path, "--epsg", str(epsg), "--json"], capture_output=True, text=True, check=False, cwd=ROOT
    )


@lru_cache(maxsize=32)
def told(name: str) -> dict[str, Any]:
    done = pose(GNSS / "gpsd" / name, ZONES.get(name, 32633))
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


@dataclass
class Gpsd:
    """What gpsd said: statuses by distinct position [degree], headings [degree], times by position."""

    positions: dict[tuple[float, float], set[int]] = field(default_factory=dict)
    headings: set[float] = field(default_factory=set)


@lru_cache(maxsize=32)
def gpsd(name: str) -> Gpsd:
    out = Gpsd()
    for line in (GNSS / "gpsd" / f"{name}.chk").read_text("utf-8", errors="replace").splitlines():
        if not line.startswith("{"):
            continue
        said = json.loads(line)
        if said["class"] == "TPV" and "lat" in said and "lon" in said:
            statuses = out.positions.setdefault((said["lat"], said["lon"]), set())
            if "status" in said:
                statuses.add(said["status"])
        elif said["class"] == "ATT" and "heading" in said:
            out.headings.add(said["heading"])
    assert out.positions
    return out


def at(name: str, lat: float, lon: float) -> list[dict[str, Any]]:
    """Return our epochs within a billionth of a degree of a place."""
    return [
        epoch
        for epoch in told(name)["epochs"]
        if epoch["lat_deg"] is not None and abs(epoch["lat_deg"] - lat) < 1e-9 and abs(epoch["lon_deg"] - lon) < 1e-9
    ]


def test_there_are_checked_logs() -> None:
    assert set(CHECKED) == set(ZONES)


@pytest.mark.parametrize("name", CHECKED)
def test_every_distinct_position_is_among_the_epochs(name: str) -> None:
    missing = [place for place in gpsd(name).positions if not at(name, *place)]
    assert not missing, f"{len(missing)} of {len(gpsd(name).positions)}"


@pytest.mark.parametrize("name", CHECKED)
def test_status_is_the_quality(name: str) -> None:
    for place, statuses in gpsd(name).positions.items():
        wanted = {STATUS[status] for status in statuses if status in STATUS}
        if wanted:
            assert {epoch["quality"] for epoch in at(name, *place)} == wanted, place


@pytest.mark.parametrize("name", CHECKED)
def test_every_heading_is_among_the_epochs(name: str) -> None:
    ours = [epoch["heading_true_deg"] for epoch in told(name)["epochs"] if epoch["heading_true_deg"] is not None]
    for heading in gpsd(name).headings:
        assert any(abs((heading - one + 180) % 360 - 180) < 1e-6 for one in ours), heading
    if not gpsd(name).headings:
        assert not ours


def test_the_logs_with_a_heading() -> None:
    assert len(gpsd("hemi.log").headings) == 4
    assert gpsd("saab-r4.log").headings == {4.0, 4.1}


def test_saab_says_more_positions_than_its_gga() -> None:
    log = (GNSS / "gpsd" / "saab-r4.log").read_bytes().decode("ascii", errors="replace")
    assert len(re.findall(r"^\$GPGGA", log, flags=re.MULTILINE)) == 12
    assert all(at("saab-r4.log", *place) for place in gpsd("saab-r4.log").positions)


def test_ac12_positions_come_from_rmc_alone() -> None:
    log = (GNSS / "gpsd" / "ac12_binary.log").read_bytes().decode("latin-1")
    for lat, lon in gpsd("ac12_binary.log").positions:
        minutes = f"{math.floor(lat):02d}{(lat % 1) * 60:07.4f}"
        assert re.search(rf"\$GPRMC,[0-9.]+,A,{re.escape(minutes)},N", log)
        assert not re.search(rf"\$GPGGA,[0-9.]+,{re.escape(minutes)},N", log)
        assert at("ac12_binary.log", lat, lon)


def test_rtk_log_by_numbers() -> None:
    epochs = told("nmea-rtk.log")["epochs"]
    assert (len(epochs), sum(e["quality"] == 2 for e in epochs), sum(e["quality"] == 4 for e in epochs)) == (
        122,
        104,
        18,
    )
    assert epochs[0]["lat_deg"] == pytest.approx(41.574965910, abs=1e-9)
    assert epochs[0]["lon_deg"] == pytest.approx(-93.750571901, abs=1e-9)
    assert epochs[0]["z"] == pytest.approx(278.161)
    assert epochs[0]["h_m"] == pytest.approx(246.719)
    assert told("nmea-rtk.log")["epochs"][0]["t"] == pytest.approx(1_584_538_099.6)


@pytest.mark.parametrize("name", CHECKED)
def test_projected_as_pyproj_projects(name: str) -> None:
    import pyproj

    onto = pyproj.Transformer.from_crs(4326, ZONES[name], always_xy=True)
    for epoch in told(name)["epochs"]:
        if epoch["lat_deg"] is not None:
            e, n = onto.transform(epoch["lon_deg"], epoch["lat_deg"])
            assert math.hypot(epoch["e"] - e, epoch["n"] - n) < 1e-4
    heights = any(epoch["z"] is not None for epoch in told(name)["epochs"])
    assert told(name)["warnings"] == ([] if heights else ["no height: the receiver sends none above mean sea level"])


def test_fuzzy_log_and_every_rejected_sentence_has_a_reason() -> None:
    for name in CHECKED:
        counted = told(name)
        assert sum(counted["rejected"].values()) == counted["sentences"]["bad"], name
        assert all(counted["rejected"]), name
    assert told("nmea-fuzzy-cases.log")["sentences"]["good"] == 28


def test_bad_check_sums_are_counted_and_give_nothing() -> None:
    """The log of bad check sums, and the fuzzy one with every check sum spoiled."""
    done = pose(GNSS / "pygpsdata-nmeabadck2.log", 32630)
    assert "Traceback" not in done.stderr
    if done.returncode == 0:
        counted = json.loads(done.stdout)
        assert sum(counted["rejected"].values()) == counted["sentences"]["bad"]
    else:
        assert done.returncode == 2 and len(done.stderr.splitlines()) == 1


def test_a_log_whose_check_sums_are_all_wrong_gives_no_position(tmp_path: Path) -> None:
    text = (GNSS / "gpsd" / "nmea-rtk.log").read_bytes()
    spoiled = re.sub(rb"\*([0-9A-F])([0-9A-F])", lambda m: b"*%02X" % (int(m[1] + m[2], 16) ^ 0x11), text)
    path = tmp_path / "spoiled.log"
    path.write_bytes(spoiled)
    done = pose(path, 32615)
    assert (done.returncode, done.stdout) == (2, "")
    assert "244" in done.stderr
    path.write_bytes(spoiled + text[-400:])
    done = pose(path, 32615)
    counted = json.loads(done.stdout)
    assert counted["sentences"]["bad"] >= 244 and counted["rejected"]["check sum differs"] >= 244
    assert len(counted["epochs"]) <= 4


@pytest.mark.parametrize(
    ("name", "epsg", "code"),
    [
        ("gpsd/ublox-zed-f9p-nmea.log", 32759, 0),
        ("gpsd/tnt-revolution.log", 32615, 2),  # compass only
        ("jiandeng_coldstart_GPS-20170526T204415.txt", 32648, 0),
        ("trimble_nmea.log", 32632, 0),
    ],
)
def test_every_other_log_is_read_or_refused_in_one_line(name: str, epsg: int, code: int) -> None:
    done = pose(GNSS / name, epsg)
    assert done.returncode == code, done.stderr
    assert "Traceback" not in done.stderr
    if code:
        assert len(done.stderr.splitlines()) == 1
        assert done.stdout == ""
    else:
        counted = json.loads(done.stdout)
        assert sum(counted["rejected"].values()) == counted["sentences"]["bad"]
        assert any(epoch["e"] is not None for epoch in counted["epochs"])
