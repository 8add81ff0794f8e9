"""Messages between a running machine and those who watch and drive it: snapshots, requests, previews.

They stand in the same frames as all others (`wire.messages`), as kinds of their own, version 1. The payload is JSON
in UTF-8: an object with the fields of the dataclass of `values.station` except its stamp, in their order, numbers
never NaN or infinite. There is one way to write a value and `decode_station` accepts no other.

| kind | message | topic | sent by |
|---|---|---|---|
| 4 | operator intent (binary, `wire.payloads`) | `intent` | page, joystick box |
| 16 | snapshot | `snapshot` | machine |
| 17 | request | `request` | page, any other program |
| 18 | setup | `setup` | machine |
| 19 | preview task | `preview-task` | machine |
| 20 | preview result | `preview-result` | preview process |
| 21 | handle | `handle` | view |
| 22 | camera | `camera` | page |
"""

import json
from dataclasses import fields, replace
from typing import Any, TypeAlias

from pydantic import TypeAdapter, ValidationError

from workgauge.values.errors import WireError
from workgauge.values.measurements import Stamp
from workgauge.values.station import Camera, Handle, PreviewResult, PreviewTask, Request, Setup, Snapshot
from workgauge.wire.messages import Message, framed, unframed

StationValue: TypeAlias = Snapshot | Request | Setup | PreviewTask | PreviewResult | Handle | Camera

_KINDS: dict[type[Any], int] = {
    Snapshot: 16,
    Request: 17,
    Setup: 18,
    PreviewTask: 19,
    PreviewResult: 20,
    Handle: 21,
    Camera: 22,
}
_TYPES = {kind: value_type for value_type, kind in _KINDS.items()}

#: Topics: below `workgauge/<machine id>/`.
TOPICS = ("intent", "snapshot", "request", "setup", "preview-task", "preview-result", "handle", "camera")

#: No request is longer than this [bytes].
LONGEST_REQUEST = 4096

#: Stands in for the stamp, which the header carries.
_NO_STAMP = Stamp("-", 0, "-", None)


def topic(machine_id: str, name: str) -> str:
    """Return the full topic of a machine; characters that mean something to routers become dashes."""
    safe = "".join("-" if c in "/*?#$ " or not c.isprintable() else c for c in machine_id)
    return f"workgauge/{safe}/{name}"


_adapters: dict[str, TypeAdapter[Any]] = {}


def _adapter(value_type: type[Any]) -> TypeAdapter[Any]:
    """Return what checks a type, made when it is first needed: that takes its time."""
    found = _adapters.get(value_type.__name__)
    if found is None:
        found = _adapters[value_type.__name__] = TypeAdapter(value_type)
    return found


def as_json(value: StationValue) -> bytes:
    """Return a value's payload.

    Raises:
        WireError: for a number that is none, or anything else that would not be read back.
    """
    adapter = _adapter(type(value))
    plain = {field.name: getattr(value, field.name) for field in fields(value) if field.name != "stamp"}
    try:
        dumped = adapter.dump_python(replace(value, stamp=_NO_STAMP), mode="json", warnings="error")
        text = json.dumps(
            {name: dumped[name] for name in plain}, allow_nan=False, ensure_ascii=False, separators=(",", ":")
        )
        return text.encode()
    except (ValueError, TypeError) as error:  # among them UnicodeEncodeError and pydantic's
        raise WireError("cannot be written", element=type(value).__name__, value=str(error).split("\n")[0]) from None


def encode_station(value: StationValue, sequence: int = 0) -> bytes:
    """Return the frame of a value; its stamp's `monotonic_ns` becomes the frame's `sent`.

    Raises:
        WireError: if it is too long (65,535 bytes), holds a number that is none, or a name does not fit.
    """
    return framed(_KINDS[type(value)], value.stamp, sequence, as_json(value))


def decode_station(frame: bytes, received_ns: int) -> Message[Any]:
    """Return the message in a frame, its value one of `StationValue`.

    Raises:
        WireError: for anything `encode_station` would not have written.
    """
    kind, stamp, sequence, sent_ns, payload = unframed(frame, received_ns)
    value_type = _TYPES.get(kind)
    if value_type is None:
        raise WireError("unknown kind", element="kind", value=kind, allowed=", ".join(map(str, _TYPES)))
    try:
        given = json.loads(payload)
        if not isinstance(given, dict) or "stamp" in given:
            raise WireError("not an object of this kind", element="payload")
        plain = {"stamp": {"machine_id": "-", "monotonic_ns": 0, "source": "-", "epoch_ns": None}, **given}
        value = _adapter(value_type).validate_json(json.dumps(plain), strict=True)
    except ValidationError as error:
        first = error.errors(include_url=False, include_input=False)[0]
        where = ".".join(map(str, first["loc"])) or "payload"
        raise WireError(first["msg"], element=f"{value_type.__name__}: {where}") from None
    except (ValueError, RecursionError) as error:  # among them JSONDecodeError and UnicodeDecodeError
        raise WireError("not JSON", element=value_type.__name__, value=str(error)[:80]) from None
    if as_json(value) != payload:
        raise WireError("written in another way than it should be", element=value_type.__name__)
    return Message(replace(value, stamp=stamp), sequence, sent_ns)
