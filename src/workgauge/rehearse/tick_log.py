"""A run's own log: every tick as it was, where everything came from, and the run out of it once more."""

import hashlib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

from workgauge.gauge.build import build_limits
from workgauge.gauge.rulebook import load_rule_book
from workgauge.gauge.rulebook import shipped_names as shipped_rules
from workgauge.geodesy.frame import SiteFrame
from workgauge.loop.config import TickConfig
from workgauge.loop.memory import first_memory
from workgauge.loop.tick import tick
from workgauge.machine.load import catalogue, description_path, load_machine
from workgauge.proximity.scene import Scene
from workgauge.record.reader import Log
from workgauge.record.setup import configuration, configured
from workgauge.record.ticks import TickRecorder, replay
from workgauge.record.writer import LogWriter
from workgauge.rehearse.session import Session
from workgauge.site.read import read_site
from workgauge.values.arrays import frozen
from workgauge.values.errors import InputError
from workgauge.wire.messages import encode

#: Key of a log's configuration that says where site, machine and rules came from.
ORIGIN = "origin"


@dataclass(frozen=True, slots=True)
class Origin:
    """The files a run was made of.

    Attributes:
        site: files. machine, rules: files, or the names of shipped ones. epsg: what was said of the coordinates.
    """

    site: tuple[str | Path, ...]
    machine: str | Path
    rules: str | Path
    epsg: int | None = None


@dataclass(frozen=True, slots=True)
class Difference:
    """The first tick that came out otherwise: when [s], and the valves (n) as logged and as they come out now."""

    t_s: float
    logged: tuple[int, ...]
    now: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class Replayed:
    """What became of a replay.

    Attributes:
        ticks: how many the log has. from_s, until_s: on its clock. different: how many did not come out the same.
        first: of those. moving: ticks whose command moved anything.
    """

    ticks: int
    from_s: float
    until_s: float
    different: int
    first: Difference | None
    moving: int


@contextmanager
def recorded(session: Session, file: Path, origin: Origin | None = None) -> Iterator[None]:
    """Record every tick of a session into a new log while the context lasts.

    Args:
        session: fresh, so that the log begins with its first tick. file: does not exist yet.
        origin: where everything came from; without it the log is replayed by its reader's own means.

    Raises:
        InputError: if the file exists or cannot be made; at the end, if something could not be written.
    """
    if session.t_s:
        raise InputError("a log begins with a session's first tick", element="session", value=f"{session.t_s:g} s")
    header = configuration(session.config)
    if origin is not None:
        header[ORIGIN] = {
            **_written(origin),
            "frame": session.limit_set.frame.origin.tolist(),
            "start_utc": session.start_utc.isoformat(),
            "joints": session.moving.words,
            "sensors": session.senses.words,
        }
    with LogWriter(file, header) as log:
        session.observe(TickRecorder(log).take)
        yield


def reopened(
    log: Log,
    *,
    site: Sequence[str | Path] = (),
    machine: str | Path | None = None,
    rules: str | Path | None = None,
) -> tuple[Scene, TickConfig]:
    """Return the limits and the tick's configuration of a logged run, made anew from its files.

    Args:
        log: opened. site, machine, rules: where the files are now; left out, where they were.

    Raises:
        InputError: if the log does not say what it was made of, or a file is gone or another than it was.
    """
    header = log.configuration
    said = header.get(ORIGIN)
    if not isinstance(said, dict):
        raise InputError("the log does not say what it was made of", file=log.file, element=ORIGIN)
    try:
        files = [_found(one, other) for one, other in _paired(said["site"], site, log.file)]
        book = _found(said["rules"], rules, shipped_rules())
        description = _found(said["machine"], machine, catalogue())
        origin, start = frozen(said["frame"], (3,)), datetime.fromisoformat(said["start_utc"])
        model = read_site([Path(file) for file in files], epsg=said["epsg"])
        config = configured(header, load_machine(description, header["attachment"]))
    except (KeyError, TypeError, ValueError) as error:
        raise InputError("its header is broken", file=log.file, element=ORIGIN, value=str(error)) from error
    limits = build_limits(model, load_rule_book(book), SiteFrame(model.crs, origin), start).limits
    return Scene(config.machine, limits), config


def replayed(log: Log, scene: Scene, config: TickConfig) -> Replayed:
    """Run the ticks of a log once more, from its inputs alone, and compare the commands with those that left then.

    Raises:
        InputError: if the log is damaged or has no tick.
    """
    memory, first = first_memory(config), None
    count = different = moving = 0
    begin_s = end_s = 0.0
    for one in replay(log, scene):
        outputs, memory, trace = tick(one.inputs, memory, config)
        end_s = one.inputs.now_ns * 1e-9
        begin_s = end_s if not count else begin_s
        count += 1
        moving += any(one.command.valves)
        if outputs.frame != encode(one.command):
            different += 1
            first = first or Difference(end_s, one.command.valves, trace.valves)
    if not count:
        raise InputError("the log has no tick", file=log.file)
    return Replayed(count, begin_s, end_s, different, first, moving)


def _written(origin: Origin) -> dict[str, Any]:
    """Return an origin with the check sums of its files."""
    return {
        "site": [_file(Path(file)) for file in origin.site],
        "machine": _named(origin.machine, catalogue(), description_path(origin.machine)),
        "rules": _named(origin.rules, shipped_rules(), Path(origin.rules)),
        "epsg": origin.epsg,
    }


def _named(name_or_path: str | Path, shipped: Sequence[str], path: Path) -> dict[str, str]:
    """Return a shipped one by its name, which this program's version vouches for, and any other as a file."""
    return {"name": str(name_or_path)} if str(name_or_path) in shipped else _file(path)


def _file(path: Path) -> dict[str, str]:
    return {"file": str(path.resolve()), "sha256": _check_sum(path)}


def _check_sum(path: Path) -> str:
    try:
        return hashlib.sha256(path.read_bytes()).hexdigest()
    except OSError as error:
        raise InputError("a file of the run cannot be read", file=path, value=error.strerror) from error


def _paired(
    said: Sequence[Mapping[str, str]], given: Sequence[str | Path], log: Path
) -> Iterator[tuple[Mapping[str, str], str | Path | None]]:
    """Yield each site file of the log with the one given in its place."""
    if given and len(given) != len(said):
        names = ", ".join(Path(one["file"]).name for one in said)
        raise InputError("other site files than the run had", file=log, element="--site", allowed=names)
    yield from zip(said, given or (None,) * len(said), strict=True)


def _found(said: Mapping[str, str], given: str | Path | None, shipped: Sequence[str] = ()) -> str | Path:
    """Return where a file of the run is, once its check sum has shown that it is the one."""
    if "name" in said:
        if given is not None and str(given) != said["name"]:
            raise InputError("another one than the run had", value=str(given), allowed=said["name"])
        if said["name"] not in shipped:
            raise InputError("not shipped any more", value=said["name"], allowed=", ".join(shipped))
        return said["name"]
    path = Path(said["file"] if given is None else given)
    if _check_sum(path) != said["sha256"]:
        raise InputError("the file is not as it was when the log was written", file=path)
    return path
