"""Messages: what was written is read back, and nothing else is accepted."""

import struct
import zlib

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from workgauge.values.arrays import frozen
from workgauge.values.commands import ValveCommand
from workgauge.values.errors import WireError
from workgauge.values.measurements import DriveMode, Intent, Levers, MachinePose, Posture, Stamp, ToolLine
from workgauge.values.navigation import AngularRate, EncoderReading, Inclination
from workgauge.wire.messages import OVERHEAD, Kind, Message, Value, decode, decode_command, encode

NOW = 7_000_000_000

names = st.text(st.characters(exclude_characters="\0", exclude_categories=["Cs"]), min_size=1, max_size=8)
times = st.integers(-(2**63) + 1, 2**63 - 1)
stamps = st.builds(Stamp, names, times, names, st.none() | times)
numbers = st.floats(width=64)


def arrays(n: int) -> st.SearchStrategy[np.ndarray]:
    return st.lists(numbers, min_size=n, max_size=n).map(frozen)


@st.composite
def covariances(draw: st.DrawFn) -> np.ndarray:
    upper = np.zeros((6, 6))
    upper[np.triu_indices(6)] = draw(arrays(21))
    return frozen(np.where(np.tri(6, k=-1).astype(bool), upper.T, upper))


postures = st.integers(0, 9).flatmap(lambda n: st.builds(Posture, stamps, arrays(n), arrays(n)))
poses = st.builds(
    MachinePose,
    stamps,
    arrays(12).map(lambda a: frozen(np.vstack([a.reshape(3, 4), [0.0, 0.0, 0.0, 1.0]]))),
    covariances(),
)
commands = st.builds(
    ValveCommand,
    stamps,
    st.integers(0, 2**32 - 1),
    st.lists(st.integers(-(2**15), 2**15 - 1), max_size=9).map(tuple),
    st.booleans(),
)
intents = st.builds(
    Intent,
    stamps,
    st.sampled_from(DriveMode),
    st.builds(Levers, *[numbers] * 6),
    st.booleans(),
    st.none() | st.builds(ToolLine, arrays(3), arrays(3)),
)
inclinations = st.builds(Inclination, stamps, numbers, numbers, numbers)
encoders = st.builds(EncoderReading, stamps, numbers, numbers)
rates = st.builds(AngularRate, stamps, arrays(3), numbers)
values = st.one_of(postures, poses, commands, intents, inclinations, encoders, rates)

STAMP = Stamp("excavator-1", 5_000_000_000, "sensors", 1_700_000_000_000_000_000)
SAMPLES: tuple[Value, ...] = (
    Posture(STAMP, frozen([0.1, -0.2, 1.5, 0.0]), frozen([1e-3] * 4)),
    MachinePose(STAMP, frozen(np.eye(4)), frozen(np.eye(6) * 1e-4)),
    ValveCommand(STAMP, 17, (100, -10_000, 0, 3), True),
    Intent(STAMP, DriveMode.LINE, Levers(right_y=0.5), True, ToolLine(frozen([1, 2, 3]), frozen([0, 1, 0]))),
    Inclination(STAMP, 0.01, -0.02, 1e-3),
    EncoderReading(STAMP, 1.25, 1e-3),
    AngularRate(STAMP, frozen([0.1, -0.2, 0.3]), 1e-2),
)


def contents(message: Message[Value]) -> tuple[object, ...]:
    """Everything in a message as comparable, bit-exact plain data."""
    value = message.value
    parts: list[object] = [type(value).__name__, message.sequence, message.sent_ns, value.stamp]
    if isinstance(value, Posture):
        parts += [value.q.tobytes(), value.sigma.tobytes()]
    elif isinstance(value, MachinePose):
        parts += [value.T_site_machine.tobytes(), value.covariance.tobytes()]
    elif isinstance(value, ValveCommand):
        parts += [value.sequence, value.valves, value.enable]
    elif isinstance(value, Inclination):
        parts.append(struct.pack("<3d", value.roll, value.pitch, value.sigma))
    elif isinstance(value, EncoderReading):
        parts.append(struct.pack("<2d", value.value, value.sigma))
    elif isinstance(value, AngularRate):
        parts += [value.rate.tobytes(), struct.pack("<d", value.sigma)]
    else:
        line = value.line
        parts += [value.mode, np.array(value.levers.values).tobytes(), value.enable]
        parts += [None] if line is None else [line.start_site.tobytes(), line.direction_site.tobytes()]
    return tuple(parts)


@settings(max_examples=300, deadline=None)
@given(values, st.integers(0, 2**32 - 1))
def test_reading_what_was_written_gives_it_back(value: Value, sequence: int) -> None:
    if isinstance(value, ValveCommand):
        sequence = value.sequence
    message = decode(encode(value, sequence), value.stamp.monotonic_ns)
    assert contents(message) == contents(Message(value, sequence, value.stamp.monotonic_ns))


@settings(max_examples=200, deadline=None)
@given(values)
def test_there_is_one_way_to_write_a_value(value: Value) -> None:
    frame = encode(value)
    message = decode(frame, value.stamp.monotonic_ns)
    assert encode(message.value, message.sequence) == frame


@pytest.mark.parametrize("value", SAMPLES, ids=lambda v: type(v).__name__)
def test_the_receiver_stamps_and_the_source_keeps_its_epoch(value: Value) -> None:
    message = decode(encode(value), NOW)
    assert message.value.stamp == Stamp("excavator-1", NOW, "sensors", 1_700_000_000_000_000_000)
    assert message.sent_ns == 5_000_000_000


@pytest.mark.parametrize("value", SAMPLES, ids=lambda v: type(v).__name__)
def test_every_single_bit_flip_is_refused(value: Value) -> None:
    frame = encode(value)
    for bit in range(8 * len(frame)):
        flipped = bytearray(frame)
        flipped[bit // 8] ^= 1 << bit % 8
        with pytest.raises(WireError):
            decode(bytes(flipped), NOW)


@pytest.mark.parametrize("value", SAMPLES, ids=lambda v: type(v).__name__)
def test_every_truncation_and_every_extra_byte_is_refused(value: Value) -> None:
    frame = encode(value)
    for end in range(len(frame)):
        with pytest.raises(WireError):
            decode(frame[:end], NOW)
    with pytest.raises(WireError, match="wrong length"):
        decode(frame + b"\0", NOW)


@settings(max_examples=500, deadline=None)
@given(st.binary(max_size=400))
def test_noise_is_never_anything_but_a_wire_error(noise: bytes) -> None:
    with pytest.raises(WireError):
        decode(noise, NOW)


def sealed(body: bytes) -> bytes:
    """A body with a check sum that fits."""
    return body + struct.pack("<I", zlib.crc32(body))


@settings(max_examples=500, deadline=None)
@given(st.sampled_from(SAMPLES), st.data())
def test_a_forged_frame_with_a_good_check_sum_is_read_whole_or_refused(value: Value, data: st.DataObject) -> None:
    body = bytearray(encode(value)[:-4])
    for _ in range(data.draw(st.integers(1, 4))):
        body[data.draw(st.integers(0, len(body) - 1))] = data.draw(st.integers(0, 255))
    cut = data.draw(st.sampled_from([len(body), len(body) - 1, 90]))
    frame = sealed(bytes(body[:cut]))
    try:
        message = decode(frame, NOW)
    except WireError:
        return
    forged = message.value
    restamped = decode(frame, message.sent_ns).value
    assert type(forged) is type(restamped)
    assert encode(restamped, message.sequence) == frame


def forge(value: Value, at: int, byte: int) -> bytes:
    body = bytearray(encode(value)[:-4])
    body[at] = byte
    return sealed(bytes(body))


@pytest.mark.parametrize(
    ("value", "at", "byte", "said"),
    [
        (SAMPLES[0], 0, 0, "not a message of ours"),
        (SAMPLES[0], 2, 9, "unknown version"),
        (SAMPLES[0], 3, 200, "unknown kind"),
        (SAMPLES[0], 26, 0xFF, "broken name"),
        (SAMPLES[0], 26, 0, "broken name"),
        (SAMPLES[0], 90, 5, "wrong payload length"),
        (SAMPLES[2], 90, 2, "not a flag"),
        (SAMPLES[2], 91, 3, "wrong payload length"),
        (SAMPLES[3], 90, 9, "unknown mode"),
        (SAMPLES[3], 91, 7, "not a flag"),
        (SAMPLES[3], 92, 0, "numbers of a line that is not given"),
        (SAMPLES[4], 3, 6, "wrong payload length"),
        (SAMPLES[5], 3, 7, "wrong payload length"),
        (SAMPLES[6], 3, 5, "wrong payload length"),
    ],
)
def test_each_forgery_is_refused_with_its_fact(value: Value, at: int, byte: int, said: str) -> None:
    with pytest.raises(WireError, match=said):
        decode(forge(value, at, byte), NOW)


def test_an_empty_payload_is_refused_for_every_kind() -> None:
    for kind in Kind:
        body = bytearray(encode(SAMPLES[0])[:90])
        body[3] = kind
        body[4:6] = b"\0\0"
        with pytest.raises(WireError, match="payload length"):
            decode(sealed(bytes(body)), NOW)


def test_only_a_valve_command_is_read_as_one() -> None:
    assert decode_command(encode(SAMPLES[2]), NOW).value.valves == (100, -10_000, 0, 3)
    with pytest.raises(WireError, match="not a valve command"):
        decode_command(encode(SAMPLES[0]), NOW)


@pytest.mark.parametrize(
    ("value", "sequence", "said"),
    [
        (Posture(STAMP, frozen([0.0] * 256), frozen([0.0] * 256)), 0, "too many joints"),
        (Posture(STAMP, frozen([0.0] * 3), frozen([0.0] * 2)), 0, "one standard deviation"),
        (Posture(STAMP, frozen([0.0]), frozen([0.0])), -1, "does not fit"),
        (Posture(STAMP, frozen([0.0]), frozen([0.0])), 2**32, "does not fit"),
        (Posture(Stamp("", 0, "s"), frozen([0.0]), frozen([0.0])), 0, "name does not fit"),
        (Posture(Stamp("m" * 33, 0, "s"), frozen([0.0]), frozen([0.0])), 0, "name does not fit"),
        (Posture(Stamp("m\0", 0, "s"), frozen([0.0]), frozen([0.0])), 0, "name does not fit"),
        (Posture(Stamp("m\udc80", 0, "s"), frozen([0.0]), frozen([0.0])), 0, "not text"),
        (Posture(Stamp("m", 0, "s", -(2**63)), frozen([0.0]), frozen([0.0])), 0, "stands for none"),
        (Posture(Stamp("m", 2**63, "s"), frozen([0.0]), frozen([0.0])), 0, "does not fit"),
        (MachinePose(STAMP, frozen(np.zeros((4, 4))), frozen(np.eye(6))), 0, "not a homogeneous matrix"),
        (MachinePose(STAMP, frozen(np.eye(4)), frozen(np.tri(6))), 0, "not symmetric"),
        (ValveCommand(STAMP, 3, (2**15,), True), None, "does not fit"),
        (ValveCommand(STAMP, 3, (0,), True), 4, "its own sequence"),
        (AngularRate(STAMP, frozen([0.0] * 2)), 0, "three components"),
        (Intent(STAMP, line=ToolLine(frozen([0.0] * 2), frozen([0.0] * 3))), 0, "two vectors of three"),
    ],
)
def test_a_value_that_does_not_fit_is_refused(value: Value, sequence: int | None, said: str) -> None:
    with pytest.raises(WireError, match=said):
        encode(value, sequence)


def test_a_foreign_type_is_refused() -> None:
    with pytest.raises(WireError, match="no message carries this type"):
        encode("stop")  # type: ignore[arg-type]


def test_the_layout_is_the_documented_one() -> None:
    frame = encode(ValveCommand(Stamp("m", 1, "s", None), 2, (1, -1), True))
    assert frame[:6] == b"WG\x01\x03\x06\x00"
    assert struct.unpack_from("<Iqq", frame, 6) == (2, 1, -(2**63))
    assert frame[26:58] == b"m".ljust(32, b"\0") and frame[58:90] == b"s".ljust(32, b"\0")
    assert frame[90:96] == b"\x01\x02\x01\x00\xff\xff"
    assert struct.unpack("<I", frame[96:]) == (zlib.crc32(frame[:96]),)
    assert len(frame) == OVERHEAD + 6
