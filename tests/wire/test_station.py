"""Messages of a running machine: what was written is read back, and nothing else is accepted."""

import json
import math
import zlib

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from workgauge.values import station
from workgauge.values.errors import WireError
from workgauge.values.measurements import Levers, Stamp
from workgauge.wire.messages import decode, encode, framed, unframed
from workgauge.wire.station import StationValue, decode_station, encode_station, topic

NOW = 9_000
names = st.text(st.characters(exclude_characters="\0", exclude_categories=["Cs"]), min_size=1, max_size=8)
texts = st.text(st.characters(exclude_categories=["Cs"]), max_size=20)
times = st.integers(-(2**63) + 1, 2**63 - 1)
numbers = st.floats(allow_nan=False, allow_infinity=False)
st.register_type_strategy(float, numbers)
st.register_type_strategy(str, texts)
st.register_type_strategy(Stamp, st.builds(Stamp, names, times, names, st.none() | times))
kinds: list[type[StationValue]] = [
    station.Snapshot,
    station.Request,
    station.Setup,
    station.PreviewTask,
    station.PreviewResult,
    station.Handle,
    station.Camera,
]
values = st.one_of([st.from_type(kind) for kind in kinds])
REQUEST = station.Request(
    Stamp("m", 5, "page-1"), "7", station.RequestKind.STATE, text="Track 2 open to traffic", on=True
)


@settings(max_examples=60, deadline=None)
@given(values, st.integers(0, 2**32 - 1))
def test_what_was_written_is_read_back_bit_by_bit(value: StationValue, sequence: int) -> None:
    frame = encode_station(value, sequence)
    message = decode_station(frame, NOW)
    stamp = value.stamp
    assert message.value.stamp == Stamp(stamp.machine_id, NOW, stamp.source, stamp.epoch_ns)
    assert message.sequence == sequence
    assert message.sent_ns == stamp.monotonic_ns
    again = type(value)(stamp, **{k: getattr(message.value, k) for k in value.__slots__ if k != "stamp"})
    assert again == value
    assert encode_station(again, sequence) == frame


def payload_of(value: StationValue) -> tuple[int, Stamp, bytes]:
    kind, stamp, _, _, payload = unframed(encode_station(value), NOW)
    return kind, stamp, payload


@pytest.mark.parametrize(
    "change",
    [
        lambda d: d | {"kind": "fly"},
        lambda d: d | {"more": 1},
        lambda d: {k: v for k, v in d.items() if k != "text"},
        lambda d: d | {"on": 1},
        lambda d: d | {"number": "3"},
        lambda d: d | {"stamp": {}},
        lambda d: [d],
        lambda d: dict(reversed(d.items())),
        lambda d: d | {"numbers": [[]]},
        lambda d: d | {"number": 10**400},
    ],
)
def test_anything_else_is_refused(change: object) -> None:
    kind, stamp, payload = payload_of(REQUEST)
    changed = change(json.loads(payload))  # type: ignore[operator]
    raw = json.dumps(changed, separators=(",", ":"), ensure_ascii=False).encode()
    with pytest.raises(WireError):
        decode_station(framed(kind, stamp, 0, raw), NOW)


@pytest.mark.parametrize("raw", [b"", b"{", b"\xff", b"null", b"[" * 60_000, b'{"id":NaN}', b" {}"])
def test_what_is_no_json_is_refused(raw: bytes) -> None:
    with pytest.raises(WireError):
        decode_station(framed(17, REQUEST.stamp, 0, raw), NOW)


@settings(max_examples=200)
@given(st.data())
def test_one_changed_byte_is_noticed_even_where_the_check_sum_is_mended(data: st.DataObject) -> None:
    frame = encode_station(REQUEST)
    place = data.draw(st.integers(76, len(frame) - 5))  # in the payload
    byte = data.draw(st.integers(0, 255).filter(lambda one: one != frame[place]))
    body = frame[:place] + bytes([byte]) + frame[place + 1 : -4]
    mended = body + zlib.crc32(body).to_bytes(4, "little")
    try:
        found = decode_station(mended, NOW)
    except WireError:
        return
    value = found.value
    assert encode_station(type(value)(Stamp("m", 5, value.stamp.source), *_rest(value))) == mended


def _rest(value: StationValue) -> list[object]:
    return [getattr(value, name) for name in value.__slots__ if name != "stamp"]


@pytest.mark.parametrize("number", [math.nan, math.inf, -math.inf])
def test_numbers_that_are_none_cannot_be_written(number: float) -> None:
    with pytest.raises(WireError):
        encode_station(station.Request(Stamp("m", 0, "s"), "1", station.RequestKind.BEAT, number=number))


def test_too_long_is_refused() -> None:
    with pytest.raises(WireError):
        encode_station(station.Request(Stamp("m", 0, "s"), "x" * 70_000, station.RequestKind.WATCH))


def test_intents_and_these_are_told_apart() -> None:
    from workgauge.values.measurements import Intent

    intent = encode(Intent(Stamp("m", 0, "box"), levers=Levers(left_x=0.5), enable=True))
    with pytest.raises(WireError, match="unknown kind"):
        decode_station(intent, NOW)
    with pytest.raises(WireError, match="unknown kind"):
        decode(encode_station(REQUEST), NOW)


@given(st.text(min_size=1))
def test_topics_never_hold_what_routers_read_as_more_than_a_name(name: str) -> None:
    found = topic(name, "snapshot")
    head, machine, tail = found.split("/")
    assert (head, tail) == ("workgauge", "snapshot")
    assert not set(machine) & set("*$#?")
    assert machine
