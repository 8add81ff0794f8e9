"""What reading two receivers costs, beside pynmeagps and pyubx2: one JSON object with `--json`.

Streams of a minute, written by this program's own encoders, 20 epochs a second:

- `nmea`: two receivers (talkers GP and GN), each GGA, GST, RMC and HDT;
- `ubx`: two receivers, each NAV-PVT and NAV-RELPOSNED;
- `both`: the two one after the other in every epoch, in one stream.

`workgauge` is everything between bytes and measurements: framing, check sums, fields, dates, stamps, in chunks as a
tick of 10 ms would find them. The peer, in the same run, is the libraries' own stream readers on the same bytes,
which frame, check and parse but make no measurements: `NMEAReader` for `nmea`, `UBXReader` with both protocols on
otherwise. CPU time of this process, least of several runs. `core_percent` is CPU time over the length of the stream.
"""

import argparse
import io
import json
import math
import sys
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from pynmeagps import NMEAReader
from pyubx2 import NMEA_PROTOCOL, UBX_PROTOCOL, UBXReader

from workgauge.values.arrays import frozen
from workgauge.values.measurements import Stamp
from workgauge.values.navigation import FixQuality, GnssError, GnssFix, GnssHeading, GnssVelocity
from workgauge.values.ports import Chunk
from workgauge.wire.nmea import nmea_bytes
from workgauge.wire.stream import StreamDecoder
from workgauge.wire.ubx import ubx_bytes

SECONDS, RATE_HZ, TICK_S = 60, 20, 0.01
START_NS = 1_798_761_600_000_000_000
MOST_PERCENT = 1.0


def epoch_bytes(k: int) -> tuple[bytes, bytes]:
    """Return the NMEA and the UBX bytes of both receivers at epoch k, moving a little."""
    stamp = Stamp("m", 0, "", START_NS + k * 1_000_000_000 // RATE_HZ)
    nmea, ubx = b"", b""
    for talker, side in (("GP", 0.0), ("GN", 2e-7)):
        sigma = 0.01 + 1e-4 * math.sin(k)
        covariance = frozen(np.diag([sigma**2, sigma**2, 4 * sigma**2]))
        place = (1.067 + 1e-9 * k + side, 0.435 - 1e-9 * k)
        fix = GnssFix(stamp, "", *place, math.nan, 120.0, 100.0, 20.0, FixQuality.FIXED, 17, 0.7, 1.0, covariance)
        velocity = GnssVelocity(stamp, "", 1.0 + 0.1 * math.sin(k), 2.0, math.nan, 0.01, 0.02)
        heading = GnssHeading(stamp, "", 1.0 + 1e-3 * k, math.nan, 0.01, 1.5, 0.001, FixQuality.FIXED)
        nmea += nmea_bytes(fix, "GGA", talker) + nmea_bytes(GnssError(stamp, "", covariance), "GST", talker)
        nmea += nmea_bytes([fix, velocity], "RMC", talker) + nmea_bytes(heading, "HDT", talker)
        ubx += ubx_bytes([fix, velocity]) + ubx_bytes(heading, "NAV-RELPOSNED")
    return nmea, ubx


def chunks(epochs: list[bytes]) -> list[Chunk]:
    """Return the stream as ticks would find it: each epoch's bytes spread over its ticks."""
    ticks = round(1 / RATE_HZ / TICK_S)
    found = []
    for k, data in enumerate(epochs):
        size = math.ceil(len(data) / ticks)
        found += [
            Chunk("gnss", round((k * ticks + i) * TICK_S * 1e9), data[i * size : (i + 1) * size])
            for i in range(ticks)
        ]
    return found


def ours(parts: list[Chunk]) -> int:
    """Decode the stream; return how many messages it had."""
    decoder = StreamDecoder("gnss", "m")
    measurements = sum(len(decoder.feed(part)) for part in parts)
    tally = decoder.tally
    if tally.bad or tally.unknown or not measurements:
        raise SystemExit(f"the stream was not read whole: {tally}")
    return tally.good


def nmea_peer(data: bytes) -> int:
    """Read the stream with pynmeagps; return how many messages it had."""
    return sum(1 for _, message in NMEAReader(io.BytesIO(data)) if message is not None)


def ubx_peer(data: bytes) -> int:
    """Read the stream with pyubx2; return how many messages it had."""
    reader = UBXReader(io.BytesIO(data), protfilter=NMEA_PROTOCOL | UBX_PROTOCOL)
    return sum(1 for _, message in reader if message is not None)


def least_s(job: Callable[[], int], runs: int) -> tuple[int, float]:
    """Return what the job counts, and its least CPU time [s]."""
    times, count = [], 0
    for _ in range(runs):
        before = time.process_time()
        count = job()
        times.append(time.process_time() - before)
    return count, min(times)


def row(name: str, epochs: list[bytes], peer: Callable[[bytes], int], runs: int) -> dict[str, Any]:
    """Measure one stream."""
    data, parts = b"".join(epochs), chunks(epochs)
    count, own_s = least_s(lambda: ours(parts), runs)
    peer_count, peer_s = least_s(lambda: peer(data), max(1, runs // 2))
    return {
        "stream": name,
        "messages": count,
        "bytes": len(data),
        "workgauge_core_percent": 100.0 * own_s / SECONDS,
        "workgauge_us_per_message": 1e6 * own_s / count,
        "workgauge_messages_per_s": count / own_s,
        "peer_messages": peer_count,
        "peer_core_percent": 100.0 * peer_s / SECONDS,
        "peer_us_per_message": 1e6 * peer_s / peer_count,
    }


def main() -> None:
    """Print the table, or the JSON object; exit code 1 if two receivers cost 1 % of a core or more."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--runs", type=int, default=5)
    given = parser.parse_args()
    both = [epoch_bytes(k) for k in range(SECONDS * RATE_HZ)]
    streams: list[tuple[str, list[bytes], Callable[[bytes], int]]] = [
        ("nmea", [nmea for nmea, _ in both], nmea_peer),
        ("ubx", [ubx for _, ubx in both], ubx_peer),
        ("both", [nmea + ubx for nmea, ubx in both], ubx_peer),
    ]
    rows = [row(name, epochs, peer, given.runs) for name, epochs, peer in streams]
    if given.json:
        print(json.dumps({"seconds": SECONDS, "rate_hz": RATE_HZ, "streams": rows}, indent=2))
    else:
        for one in rows:
            print(
                f"{one['stream']:5} {one['messages']:6} messages: {one['workgauge_core_percent']:.2f} % of a core, "
                f"{one['workgauge_us_per_message']:.1f} us each; the libraries' readers "
                f"{one['peer_core_percent']:.2f} %, {one['peer_us_per_message']:.1f} us each"
            )
    sys.exit(any(one["workgauge_core_percent"] >= MOST_PERCENT for one in rows))


if __name__ == "__main__":
    main()
