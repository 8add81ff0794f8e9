"""Recording ticks, and replaying them: the same inputs in the same order give the same valves."""

import json
from collections.abc import Iterator
from dataclasses import dataclass, fields
from typing import Any, get_type_hints

from workgauge.loop.inputs import TickInputs
from workgauge.loop.tick import Trace
from workgauge.proximity.scene import Scene
from workgauge.record.plain import from_plain, to_plain
from workgauge.record.reader import Log
from workgauge.record.topics import Moment, Reasons, Velocities, line, transform
from workgauge.record.writer import LogWriter
from workgauge.values.commands import ValveCommand
from workgauge.values.errors import InputError
from workgauge.wire.messages import decode_command

#: The inputs that have topics of their own; each is written when it is another than the tick before had.
_OWN = ("posture", "pose", "intent", "job")
#: The inputs that stand in the tick's own message.
_REST = tuple(field.name for field in fields(TickInputs) if field.name not in (*_OWN, "now_ns", "scene"))


class TickRecorder:
    """Hands what enters and leaves each tick to a log.

    Args:
        log: where it goes.
    """

    def __init__(self, log: LogWriter) -> None:
        self._log = log
        self._last: dict[str, object] = {}
        self._reasons: tuple[object, ...] | None = None

    def take(self, inputs: TickInputs, frame: bytes, trace: Trace) -> None:
        """Take in one tick: its inputs, the command bytes that left, and what it saw."""
        now, log = inputs.now_ns, self._log
        for name in _OWN:
            value = getattr(inputs, name)
            if value is not None and value is not self._last.get(name):
                self._last[name] = value
                log.write(f"/{name}", now, value)
                shown = transform(now, value) if name == "pose" else None
                if shown is not None:
                    log.write("/tf", now, shown)
        rest = {name: to_plain(getattr(inputs, name)) for name in _REST}
        had = {name: getattr(inputs, name) is not None for name in _OWN}
        log.write("/tick", now, Moment(now_ns=now, rest=json.dumps(rest, sort_keys=True), **had))
        log.write("/velocities", now, Velocities(trace.desired, trace.allowed))
        log.write("/valves", now, decode_command(frame, now).value)
        nearest = None if trace.clearances is None else trace.clearances.nearest()
        if nearest is not None:
            log.write("/clearance", now, nearest)
        said = (*((one.code, one.link, one.limit, one.joint) for one in trace.reasons),)
        if said != self._reasons:
            self._reasons = said
            log.write("/reasons", now, Reasons(trace.reasons, trace.scale))
            for reason in trace.reasons:
                log.write("/log", now, line(now, reason))


@dataclass(frozen=True, slots=True, eq=False)
class RecordedTick:
    """One tick from a log: its inputs as they were, and the command that left it."""

    inputs: TickInputs
    command: ValveCommand


def replay(log: Log, scene: Scene) -> Iterator[RecordedTick]:
    """Yield the ticks of a log, in order; a tick whose command is missing at a cut end is left out.

    Args:
        log: opened with `open_log`. scene: the limits the run had, made from the same files and rules.

    Raises:
        InputError: if the log is damaged, or a tick names an input that is not there.
    """
    hints = get_type_hints(TickInputs)
    newest: dict[str, Any] = {}
    moment: Moment | None = None
    for topic, time_ns, value in log.entries("/posture", "/pose", "/intent", "/job", "/tick", "/valves"):
        if topic == "/tick":
            moment = value
        elif topic == "/valves":
            if moment is None or moment.now_ns != time_ns:
                raise InputError("a command without its tick", file=log.file, element="/valves", value=time_ns)
            given: dict[str, Any] = {
                name: _input(log, newest, name) if getattr(moment, name) else None for name in _OWN
            }
            try:
                plain = json.loads(moment.rest)
                given |= {name: from_plain(hints[name], plain[name]) for name in _REST}
            except (ValueError, KeyError, TypeError) as error:
                raise InputError("not a tick", file=log.file, element="/tick", value=str(error)) from None
            yield RecordedTick(TickInputs(now_ns=moment.now_ns, scene=scene, **given), value)
            moment = None
        else:
            newest[topic[1:]] = value


def _input(log: Log, newest: dict[str, Any], name: str) -> Any:
    if name not in newest:
        raise InputError("a tick used an input that is not in the log", file=log.file, element=f"/{name}")
    return newest[name]
