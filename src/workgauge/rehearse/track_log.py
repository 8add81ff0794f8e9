"""Receiver logs as a track in the site's coordinates: `workgauge pose`, as data."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from workgauge.geodesy.crs import ProjectedCrs
from workgauge.geodesy.heights import HeightModel
from workgauge.machine.positioning import FixSigmas
from workgauge.positioning.epochs import Fix, Gatherer, Instant, fixes_of, times
from workgauge.rehearse.log_file import LogFile, OnBytes
from workgauge.values.arrays import Floats, Ints, frozen, frozen_ints
from workgauge.values.errors import InputError
from workgauge.values.navigation import FixQuality
from workgauge.values.ports import Chunk
from workgauge.wire.stream import StreamDecoder, Tally

#: A log without one good sentence in its first bytes is none.
TRY_BYTES = 4 << 20

#: A datum that lies farther than this from the receivers' is worth a warning [m].
DATUM_SHIFT_M = 1.0


@dataclass(frozen=True, slots=True, eq=False)
class Track:
    """n epochs in the order of the logs; NaN where nothing is known.

    Attributes:
        t_s: (n,) UTC since 1970 if `utc`, else seconds since the first epoch's midnight.
        instants: (n,) index of the moment each epoch belongs to.
        latitude, longitude: (n,) [rad]. height_ellipsoid_m: (n,). e, n, z: (n,) in the site's system [m].
        quality: (n,) as in GGA, -1 unknown. sigma_m: (n, 3) east, north, up: as the receiver states it, else what its
            quality is worth; sigma_stated: (n,) which of the two.
        correction_age_s: (n,) of the differential correction.
        true_heading, heading: (n,) from true and from grid north, clockwise [rad].
        sources, sentences: (n,) receiver, and what its epoch was put together from.
        tally: good, bad and unknown sentences, and why the bad ones are.
        height_words: where heights come from. warnings: what is doubtful.
    """

    files: tuple[str, ...]
    crs: ProjectedCrs
    utc: bool
    t_s: Floats
    instants: Ints
    latitude: Floats
    longitude: Floats
    height_ellipsoid_m: Floats
    e: Floats
    n: Floats
    z: Floats
    quality: Ints
    sigma_m: Floats
    sigma_stated: NDArray[np.bool_]
    correction_age_s: Floats
    true_heading: Floats
    heading: Floats
    sources: tuple[str, ...]
    sentences: tuple[tuple[str, ...], ...]
    tally: Mapping[str, Any]
    height_words: str
    warnings: tuple[str, ...]

    def __len__(self) -> int:
        return len(self.t_s)

    @property
    def placed(self) -> Any:
        """(n,) whether the epoch has a place in the site's system."""
        return np.isfinite(self.e) & np.isfinite(self.n)

    @property
    def somewhere(self) -> tuple[float, float, float]:
        """A place of the track: its first, height 0 where it has none [m]."""
        i = int(np.flatnonzero(self.placed)[0])
        return float(self.e[i]), float(self.n[i]), float(np.nan_to_num(self.z[i]))


def read_instants(
    logs: Sequence[LogFile], on_bytes: OnBytes | None = None, machine_id: str = "log"
) -> tuple[list[Instant], dict[str, Any]]:
    """Return the moments of logs, log after log, and the count of their sentences.

    Args:
        machine_id: whose frames of link sensors count, if there are any among the sentences.

    Raises:
        InputError: if a log cannot be read, or holds nothing that a receiver says.
    """
    instants: list[Instant] = []
    count: dict[str, Any] = {"good": 0, "bad": 0, "unknown": 0, "reasons": {}}
    for log in logs:
        gatherer, decoder, seen = Gatherer(), StreamDecoder(log.port, machine_id), 0
        for block in log.blocks(on_bytes):
            for measurement in decoder.feed(Chunk(log.port, 0, block)):
                gatherer.take(measurement)
            seen += len(block)
            if seen >= TRY_BYTES and not decoder.tally.good + decoder.tally.unknown:
                break
        for measurement in decoder.finish():
            gatherer.take(measurement)
        _refuse_junk(log, decoder.tally)
        _add(count, decoder.tally)
        instants.extend(gatherer.finished())
    return instants, count


def read_track(
    logs: Sequence[LogFile],
    crs: ProjectedCrs,
    heights: HeightModel,
    on_bytes: OnBytes | None = None,
    machine_id: str = "log",
) -> Track:
    """Return the track of logs in a projected system; for `machine_id` see `read_instants`.

    Raises:
        InputError: if a log cannot be read, or none holds a position.
    """
    instants, count = read_instants(logs, on_bytes, machine_id)
    return track_of(instants, count, crs, heights, tuple(str(log.path) for log in logs))


def track_of(
    instants: Sequence[Instant],
    count: Mapping[str, Any],
    crs: ProjectedCrs,
    heights: HeightModel,
    files: tuple[str, ...] = (),
) -> Track:
    """Return the track of moments (see `read_track`)."""
    rows = list(fixes_of(instants))
    if not any(fix is not None and fix.placed for _, fix in rows):
        raise InputError(
            "no position in the log" if len(files) == 1 else "no position in the logs",
            file=files[0] if len(files) == 1 else None,
            value=f"{count['good']} good sentences, {count['bad']} bad, {count['unknown']} of unknown kinds",
            allowed="sentences with a position: GGA, RMC, GLL, PTNL GGK or PJK, NAV-PVT, NAV-HPPOSLLH",
        )
    index = frozen_ints([i for i, _ in rows])
    empty = Fix("", math.nan, math.nan)
    fixes = [empty if fix is None else fix for _, fix in rows]
    lat, lon, msl, ellipsoid, separation, grid_e, grid_n, grid_z = _columns(fixes)
    e, n = crs.from_geodetic(lat, lon)
    e, n = np.where(np.isnan(lat), grid_e, e), np.where(np.isnan(lat), grid_n, n)
    z = heights.heights(lat, lon, msl, ellipsoid, separation)
    z = np.where(np.isnan(lat), grid_z, z)
    ellipsoid = np.where(np.isfinite(ellipsoid), ellipsoid, msl + separation)
    true_heading = np.array([_heading(instants[i]) for i, _ in rows])
    t_s, utc = times(instants)
    sources = tuple(fix.source if fix is not None else _heading_source(instants[i]) for i, fix in rows)
    return Track(
        files=files,
        crs=crs,
        utc=utc,
        t_s=frozen(t_s[index]),
        instants=index,
        latitude=frozen(lat),
        longitude=frozen(lon),
        height_ellipsoid_m=frozen(ellipsoid),
        e=frozen(e),
        n=frozen(n),
        z=frozen(z),
        quality=frozen_ints([-1 if fix.quality is None else int(fix.quality) for fix in fixes]),
        sigma_m=frozen([_sigma(fix) for fix in fixes]),
        sigma_stated=np.array([fix.covariance is not None for fix in fixes], dtype=np.bool_),
        correction_age_s=frozen([fix.correction_age_s for fix in fixes]),
        true_heading=frozen(true_heading),
        heading=frozen(_grid_headings(crs, true_heading, e, n)),
        sources=sources,
        sentences=tuple(tuple(fix.sentences) for fix in fixes),
        tally=count,
        height_words=heights.words,
        warnings=_doubts(crs, lat, lon, e, n, heights, z),
    )


def _columns(fixes: Sequence[Fix]) -> Floats:
    rows = [
        (
            fix.latitude,
            fix.longitude,
            fix.height_msl_m,
            fix.height_ellipsoid_m,
            fix.separation_m,
            fix.e,
            fix.n,
            fix.grid_height_m,
        )
        for fix in fixes
    ]
    return np.array(rows, dtype=np.float64).T


def _heading(instant: Instant) -> float:
    return math.nan if instant.heading is None else instant.heading.heading


def _heading_source(instant: Instant) -> str:
    return instant.port if instant.heading is None else instant.heading.stamp.source


def _sigma(fix: Fix) -> tuple[float, float, float]:
    if fix.covariance is None:
        if not fix.placed or fix.quality in (None, FixQuality.NONE):
            return math.nan, math.nan, math.nan
        level, height = FixSigmas().of(fix.quality)
        return level, level, height
    variances = np.diagonal(fix.covariance)
    with np.errstate(invalid="ignore"):
        east, north, up = np.sqrt(np.where(variances >= 0, variances, np.nan))
    return float(east), float(north), float(up)


def _grid_headings(crs: ProjectedCrs, true_heading: Floats, e: Floats, n: Floats) -> Floats:
    """Return grid headings (n,), each at its own place or, without one, at the nearest one before or after."""
    out = np.full(len(true_heading), np.nan)
    asked = np.flatnonzero(np.isfinite(true_heading))
    known = np.flatnonzero(np.isfinite(e) & np.isfinite(n))
    if len(asked) and len(known):
        after = np.clip(np.searchsorted(known, asked), 0, len(known) - 1)
        before = np.clip(after - 1, 0, None)
        nearer = np.abs(asked - known[before]) < np.abs(known[after] - asked)
        place = known[np.where(nearer, before, after)]
        out[asked] = crs.grid_heading(true_heading[asked], e[place], n[place])
    return out


def _doubts(
    crs: ProjectedCrs, lat: Floats, lon: Floats, e: Floats, n: Floats, heights: HeightModel, z: Floats
) -> tuple[str, ...]:
    """Return what speaks against the system chosen, and which heights are missing."""
    name = crs.name if crs.epsg is None else f"EPSG {crs.epsg} ({crs.name})"
    out = []
    geodetic = np.flatnonzero(np.isfinite(lat) & np.isfinite(lon))
    if len(geodetic):
        outside = geodetic[~crs.contains(e[geodetic], n[geodetic])]
        if len(outside):
            where = f"{math.degrees(lat[outside[0]]):.4f}°, {math.degrees(lon[outside[0]]):.4f}°"
            out.append(
                f"{len(outside)} of {len(geodetic)} positions lie outside the area {name} is made for, the first at "
                f"latitude and longitude {where}: is it the right system?"
            )
        shift = crs.datum_shift_m(float(lat[geodetic[0]]), float(lon[geodetic[0]]))
        if math.isnan(shift):
            out.append(f"no shift is known from the receivers' datum to that of {name}: positions may be off by it")
        elif shift > DATUM_SHIFT_M:
            out.append(
                f"{name} stands on another datum than receivers deliver: positions are off by {shift:.0f} m; "
                "take a system on ETRS89 or WGS 84"
            )
        if np.isnan(z[geodetic]).all():
            if heights.kind == "sentence":
                out.append("no height: the receiver sends none above mean sea level")
            else:
                out.append("no height: the receiver sends no ellipsoidal height, or the grid does not reach there")
    if len(geodetic) < np.count_nonzero(np.isfinite(e)):
        out.append(f"positions that the receiver sends in its own projection (PTNL,PJK) are taken as {name}")
    return tuple(out)


def _refuse_junk(log: LogFile, tally: Tally) -> None:
    if not tally.good + tally.unknown:
        raise InputError(
            "no receiver's log: not one good sentence in it",
            file=log.path,
            value=f"{tally.bad} broken ones",
            allowed="NMEA or UBX, as a receiver sends it",
        )


def _add(count: dict[str, Any], tally: Tally) -> None:
    count["good"] += tally.good
    count["bad"] += tally.bad
    count["unknown"] += tally.unknown
    for reason, many in tally.reasons.items():
        count["reasons"][reason] = count["reasons"].get(reason, 0) + many
