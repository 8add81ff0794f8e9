"""Logs of real receivers, and what another program (gpsd) made of them."""

import json
import math
from collections import Counter
from datetime import datetime
from pathlib import Path

import pytest
from pynmeagps import NMEAReader
from pyubx2 import UBXReader

from workgauge.values.navigation import (
    FixQuality,
    GnssError,
    GnssFix,
    GnssGridFix,
    GnssHeading,
    GnssVelocity,
    Inclination,
    Measurement,
    TurnRate,
)
from workgauge.values.ports import Chunk
from workgauge.wire.framing import ubx_checksum
from workgauge.wire.stream import StreamDecoder, Tally

GNSS = Path(__file__).parents[2] / "../shared/data/gnss"
CHECKED = (
    "ac12_binary",
    "hemi",
    "nmea-fuzzy-cases",
    "nmea-rtk",
    "saab-r4",
    "ublox-f9p-hpnmea",
    "ublox-neo-m8p",
    "ublox-zed-f9p-rtk",
)
#: gpsd's status to the quality of the fix; gpsd leaves out a status it does not know, or that of a single fix.
STATUS = {2: FixQuality.DIFFERENTIAL, 3: FixQuality.FIXED, 4: FixQuality.FLOAT}
NEAR_DEG = 1e-9


def log(name: str) -> bytes:
    path = GNSS / name
    if not path.exists():
        pytest.skip(f"no {path}: the logs of other people's receivers are not here")
    return path.read_bytes()


def decoded(data: bytes) -> tuple[list[Measurement], Tally]:
    decoder = StreamDecoder("gnss", "machine")
    found = decoder.feed(Chunk("gnss", 0, data)) + decoder.finish()
    return found, decoder.tally


def fixes(found: list[Measurement]) -> list[GnssFix]:
    return [m for m in found if isinstance(m, GnssFix) and not math.isnan(m.latitude)]


def reports(name: str) -> list[dict[str, object]]:
    """Everything of class TPV in gpsd's answers."""
    lines = log(f"gpsd/{name}.log.chk").decode("utf-8", "replace").splitlines()
    return [report for line in lines if line.startswith('{"class":"TPV"') for report in [json.loads(line)]]


@pytest.mark.parametrize("name", CHECKED)
def test_every_position_that_gpsd_reports_is_among_the_fixes(name: str) -> None:
    found, _ = decoded(log(f"gpsd/{name}.log"))
    ours = [(math.degrees(f.latitude), math.degrees(f.longitude), f.quality) for f in fixes(found)]
    theirs = {(r["lat"], r["lon"], r.get("status")) for r in reports(name) if "lat" in r}
    assert theirs
    for lat, lon, status in theirs:
        near = [q for y, x, q in ours if abs(y - lat) < NEAR_DEG and abs(x - lon) < NEAR_DEG]
        assert near, f"{name}: {lat}, {lon}"
        if status is not None:
            assert STATUS[status] in near, f"{name}: {lat}, {lon}, {status}: {near}"


#: Of this epoch the log has lost bytes, NAV-PVT's among them; gpsd puts it together from messages we do not read.
LOST = {("ublox-zed-f9p-rtk", "2022-10-11T11:04:27.000Z")}


@pytest.mark.parametrize("name", CHECKED)
def test_every_time_that_gpsd_reports_is_among_the_epochs(name: str) -> None:
    found, _ = decoded(log(f"gpsd/{name}.log"))
    ours = {m.stamp.epoch_ns for m in found}
    theirs = {str(r["time"]) for r in reports(name) if "lat" in r and "time" in r}
    assert theirs
    for text in theirs:
        assert utc_ns(text) in ours or (name, text) in LOST, text


def utc_ns(text: str) -> int:
    return round(datetime.fromisoformat(text.replace("Z", "+00:00")).timestamp() * 1000) * 1_000_000


@pytest.mark.parametrize("name", ["hemi", "saab-r4"])
def test_every_heading_that_gpsd_reports_is_among_the_headings(name: str) -> None:
    lines = log(f"gpsd/{name}.log.chk").decode("utf-8", "replace").splitlines()
    answers = [json.loads(line) for line in lines if line.startswith("{")]
    theirs = {a["heading"] for a in answers if a["class"] in ("TPV", "ATT") and "heading" in a}
    found, _ = decoded(log(f"gpsd/{name}.log"))
    ours = {round(math.degrees(m.heading), 6) for m in found if isinstance(m, GnssHeading)}
    assert theirs and theirs <= ours


#: good, bad, unknown, why bad.
TALLIES = {
    "gpsd/ac12_binary.log": (20, 17, 28, {"no check sum": 1, "a byte that is no text": 16}),
    "gpsd/hemi.log": (753, 0, 0, {}),
    "gpsd/nmea-fuzzy-cases.log": (28, 0, 0, {}),
    "gpsd/nmea-rtk.log": (244, 0, 0, {}),
    "gpsd/saab-r4.log": (84, 0, 38, {}),
    "gpsd/tnt-revolution.log": (0, 0, 60, {}),
    "gpsd/ublox-f9p-hpnmea.log": (27, 0, 112, {}),
    "gpsd/ublox-neo-m8p.log": (59, 1, 425, {"the stream ends inside": 1}),
    "gpsd/ublox-zed-f9p-nmea.log": (174, 0, 841, {}),
    "gpsd/ublox-zed-f9p-rtk.log": (9, 2, 56, {"check sum differs": 1, "a byte that is no text": 1}),
    "jiandeng_coldstart_GPS-20170526T204415.txt": (3960, 0, 6080, {}),
    "pygpsdata-nmeabadck2.log": (2, 1, 5, {"check sum is no number": 1}),
    "trimble_nmea.log": (7, 0, 14, {}),
}


@pytest.mark.parametrize("name", TALLIES)
def test_what_becomes_of_every_sentence_is_counted(name: str) -> None:
    _, tally = decoded(log(name))
    assert (tally.good, tally.bad, tally.unknown, tally.reasons) == TALLIES[name]
    assert sum(tally.names.values()) == tally.good + tally.unknown
    assert sum(tally.reasons.values()) == tally.bad


@pytest.mark.parametrize("name", TALLIES)
def test_the_logs_read_the_same_in_pieces(name: str) -> None:
    data = log(name)
    whole, tally = decoded(data)
    for size in (1, 7, 64, 1000):
        if size == 1 and len(data) > 100_000:
            continue
        decoder = StreamDecoder("gnss", "machine")
        found: list[Measurement] = []
        for at in range(0, len(data), size):
            found += decoder.feed(Chunk("gnss", 0, data[at : at + size]))
        found += decoder.finish()
        assert [repr(m) for m in found] == [repr(m) for m in whole]
        assert decoder.tally == tally


@pytest.mark.parametrize("name", ["gpsd/nmea-rtk.log", "gpsd/ublox-zed-f9p-nmea.log", "gpsd/hemi.log"])
def test_positions_agree_with_the_library_whose_layouts_are_used(name: str) -> None:
    """It rounds degrees to ten decimals; by it, nothing else than that differs."""
    found, _ = decoded(log(name))
    ours = [(f.sentence, math.degrees(f.latitude), math.degrees(f.longitude)) for f in fixes(found)]
    theirs = []
    for line in log(name).split(b"\n"):
        if line[3:6] in (b"GGA", b"RMC", b"GLL") and line.startswith(b"$"):
            message = NMEAReader.parse(line.strip() + b"\r\n")
            if isinstance(message.lat, float):
                theirs.append((message.msgID, message.lat, message.lon))
    assert len(ours) == len(theirs) > 20
    for (kind, lat, lon), (their_kind, their_lat, their_lon) in zip(ours, theirs, strict=True):
        assert kind == their_kind
        assert abs(lat - their_lat) < 1e-10 and abs(lon - their_lon) < 1e-10


def test_ubx_agrees_with_the_library_whose_layouts_are_used() -> None:
    data = log("gpsd/ublox-neo-m8p.log")
    found, _ = decoded(data)
    velocities = [m for m in found if isinstance(m, GnssVelocity)]
    at = -1
    for k in range(len(velocities)):
        at = data.find(b"\xb5b\x01\x07\x5c\x00", at + 1)
        theirs = UBXReader.parse(data[at : at + 100])
        fix = fixes(found)[k]
        assert math.degrees(fix.latitude) == pytest.approx(theirs.lat, abs=1e-12)
        assert math.degrees(fix.longitude) == pytest.approx(theirs.lon, abs=1e-12)
        assert fix.height_ellipsoid_m == pytest.approx(theirs.height / 1000) and fix.satellites == theirs.numSV
        assert fix.covariance is not None
        assert math.sqrt(fix.covariance[0, 0]) == pytest.approx(theirs.hAcc / 1000)
        assert math.sqrt(fix.covariance[2, 2]) == pytest.approx(theirs.vAcc / 1000)
        assert velocities[k].speed_m_s == pytest.approx(theirs.gSpeed / 1000)
        assert velocities[k].climb_m_s == pytest.approx(-theirs.velD / 1000)
    assert len(velocities) == 59


def test_every_ubx_frame_of_the_damaged_log_that_has_its_check_sum_is_read() -> None:
    data = log("gpsd/ublox-zed-f9p-rtk.log")
    _, tally = decoded(data)
    whole, at = 0, data.find(b"\xb5b")
    while at >= 0:
        end = at + 6 + int.from_bytes(data[at + 4 : at + 6], "little")
        whole += ubx_checksum(data[at + 2 : end]) == data[end : end + 2]
        at = data.find(b"\xb5b", at + 1)
    assert whole == tally.good + tally.unknown == 65


def test_the_fuzzy_log_gives_each_of_its_fixes_twice() -> None:
    found, tally = decoded(log("gpsd/nmea-fuzzy-cases.log"))
    assert tally.bad == 0
    kinds = Counter((f.sentence, f.quality) for f in fixes(found))
    # RMC has no letter for what it does not know: this receiver writes D with a fixed solution
    assert kinds == {
        ("GGA", FixQuality.DIFFERENTIAL): 10,
        ("GGA", FixQuality.FIXED): 4,
        ("RMC", FixQuality.DIFFERENTIAL): 14,
    }


def test_the_rtk_log_has_the_fixes_of_the_published_count() -> None:
    found, _ = decoded(log("gpsd/nmea-rtk.log"))
    gga = [f for f in fixes(found) if f.sentence == "GGA"]
    assert [f.quality for f in gga] == [FixQuality.DIFFERENTIAL] * 104 + [FixQuality.FIXED] * 18
    assert math.degrees(gga[0].latitude) == pytest.approx(41.574965910, abs=1e-9)
    assert math.degrees(gga[0].longitude) == pytest.approx(-93.750571901, abs=1e-9)
    assert {f.stamp.source for f in gga} == {"gnss/GP", "gnss/GN"}
    assert gga[0].height_ellipsoid_m == pytest.approx(246.719) and gga[0].correction_age_s == 6.6
    # before the first RMC no date is known; then every sentence with a time has its epoch
    assert gga[0].stamp.epoch_ns is None
    assert all(f.stamp.epoch_ns is not None for f in gga[1:])


def test_the_positions_gpsd_gives_for_the_ac12_stand_in_its_rmc_alone() -> None:
    found, _ = decoded(log("gpsd/ac12_binary.log"))
    theirs = {(r["lat"], r["lon"]) for r in reports("ac12_binary") if "lat" in r}
    by_sentence = {}
    for sentence in ("GGA", "RMC", "PASHR,POS"):
        ours = [(math.degrees(f.latitude), math.degrees(f.longitude)) for f in fixes(found) if f.sentence == sentence]
        assert len(ours) == 5
        by_sentence[sentence] = sum(
            any(abs(a - c) < NEAR_DEG and abs(b - d) < NEAR_DEG for c, d in ours) for a, b in theirs
        )
    assert by_sentence["RMC"] == len(theirs) and by_sentence["GGA"] < len(theirs)


def test_the_makers_own_sentences_are_read_as_their_manuals_say() -> None:
    found, _ = decoded(log("trimble_nmea.log"))
    avr = [m for m in found if isinstance(m, GnssHeading) and m.sentence == "PTNL,AVR"]
    assert [round(math.degrees(m.heading), 6) for m in avr] == [52.1531, 52.18]
    assert math.degrees(avr[0].pitch) == pytest.approx(-0.0806) and math.isnan(avr[1].pitch)
    assert [m.baseline_m for m in avr] == [12.575, 12.579]
    assert {m.quality for m in avr} == {FixQuality.FIXED}
    (ggk,) = fixes(found)
    assert math.degrees(ggk.latitude) == pytest.approx(50 + 0.97323841 / 60, abs=1e-12)
    assert ggk.height_ellipsoid_m == 150.790 and ggk.quality is FixQuality.DIFFERENTIAL
    assert ggk.stamp.epoch_ns == utc_ns("2010-05-19T10:29:39.000Z")  # the month comes first
    first, second = (m for m in found if isinstance(m, GnssGridFix))
    assert (first.northing_m, first.easting_m, first.height_m) == (805083.350, 388997.346, 25.478)
    assert first.orthometric and not second.orthometric
    assert first.stamp.epoch_ns == utc_ns("2012-01-11T20:28:31.500Z")
    assert second.stamp.epoch_ns == utc_ns("1996-08-17T01:07:17.000Z")
    (rot,) = (m for m in found if isinstance(m, TurnRate))
    assert math.degrees(rot.rate) * 60 == pytest.approx(-35.6)  # to the right
    (tilt,) = (m for m in found if isinstance(m, Inclination))
    assert math.degrees(tilt.roll) == pytest.approx(-0.624) and math.degrees(tilt.pitch) == pytest.approx(-0.245)
    (pashr,) = (m for m in found if isinstance(m, GnssHeading) and m.sentence == "PASHR")
    assert math.degrees(pashr.heading) == pytest.approx(179.885) and pashr.quality is FixQuality.FIXED
    assert math.degrees(pashr.sigma) == pytest.approx(0.502) and math.degrees(pashr.pitch) == pytest.approx(0.245)


def test_a_receiver_without_a_fix_gives_no_position_and_no_made_up_date() -> None:
    found, _ = decoded(log("jiandeng_coldstart_GPS-20170526T204415.txt"))
    gga = [m for m in found if isinstance(m, GnssFix) and m.sentence == "GGA"]
    assert Counter(m.quality for m in gga) == {
        FixQuality.NONE: 704,
        FixQuality.SINGLE: 463,
        FixQuality.DIFFERENTIAL: 155,
    }
    assert all(math.isnan(m.latitude) == (m.quality is FixQuality.NONE) for m in gga)
    epochs = [m.stamp.epoch_ns for m in found if m.stamp.epoch_ns is not None]
    # RMC says 1980 while it is not valid: nothing of it may reach an epoch
    assert min(epochs) > utc_ns("2017-05-26T00:00:00Z") and max(epochs) < utc_ns("2017-05-27T00:00:00Z")


def test_errors_are_read_from_the_sigmas_where_no_ellipse_is_given() -> None:
    data = log("gpsd/ublox-zed-f9p-nmea.log")
    found, _ = decoded(data)
    lines = [line for line in data.split(b"\r\n") if line.startswith(b"$GNGST")]
    errors = [m for m in found if isinstance(m, GnssError)]
    assert len(errors) == len(lines) == 29
    for error, line in zip(errors, lines, strict=True):
        north, east, up = (float(x) for x in line.split(b"*")[0].split(b",")[6:9])
        given = [math.sqrt(error.covariance[k, k]) for k in range(3)]
        assert given == pytest.approx([east, north, up])
