"""Values as JSON and back, bit for bit; what is none is refused."""

import json
import math
from typing import get_type_hints

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from workgauge.loop.inputs import TickInputs
from workgauge.record.plain import from_plain, json_schema, to_plain
from workgauge.record.topics import TOPICS, Reasons
from workgauge.values.arrays import frozen
from workgauge.values.clearances import Clearance
from workgauge.values.commands import ValveCommand
from workgauge.values.measurements import DriveMode, Intent, Levers, MachinePose, Posture, Stamp, ToolLine
from workgauge.values.reasons import Reason, ReasonCode

numbers = st.floats(allow_nan=True, allow_infinity=True)
vectors = st.lists(numbers, min_size=3, max_size=3).map(frozen)
texts = st.text(max_size=12)
stamps = st.builds(
    Stamp, texts, st.integers(-(2**63), 2**63 - 1), texts, st.none() | st.integers(-(2**63) + 1, 2**63 - 1)
)
reasons = st.builds(
    Reason,
    st.sampled_from(list(ReasonCode)),
    texts,
    st.none() | texts,
    st.none() | texts,
    clearance_m=st.none() | numbers,
)
values = st.one_of(
    st.builds(Posture, stamps, vectors, vectors),
    st.builds(
        lambda stamp, T, c: MachinePose(stamp, T, c), stamps, st.lists(vectors, min_size=4).map(frozen), vectors
    ),
    st.builds(
        Intent,
        stamps,
        st.sampled_from(list(DriveMode)),
        st.builds(Levers, *[st.floats(-1, 1)] * 6),
        st.booleans(),
        st.none() | st.builds(ToolLine, vectors, vectors),
    ),
    st.builds(
        ValveCommand,
        stamps,
        st.integers(0, 2**32 - 1),
        st.lists(st.integers(-(10**4), 10**4)).map(tuple),
        st.booleans(),
    ),
    st.builds(Clearance, numbers, vectors, vectors, vectors, texts, texts, st.integers(-1, 9), numbers, numbers),
    st.builds(Reasons, st.lists(reasons, max_size=3).map(tuple), numbers),
)


def bits(value: object) -> object:
    """Return something that is equal only if every bit is."""
    if isinstance(value, np.ndarray):
        return value.shape, np.where(np.isnan(value), math.nan, value).tobytes()
    if isinstance(value, float):
        return "nan" if math.isnan(value) else value.hex()
    if hasattr(value, "__dataclass_fields__"):
        return type(value), *(bits(getattr(value, name)) for name in value.__dataclass_fields__)
    if isinstance(value, tuple):
        return tuple(map(bits, value))
    return value


@settings(max_examples=300, deadline=None)
@given(values)
def test_a_value_comes_back_bit_for_bit_through_json(value: object) -> None:
    text = json.dumps(to_plain(value), allow_nan=False)
    back = from_plain(type(value), json.loads(text))
    assert bits(back) == bits(value)
    assert json.dumps(to_plain(back), allow_nan=False) == text


def test_every_input_of_a_tick_has_a_plain_form() -> None:
    hints = get_type_hints(TickInputs)
    assert from_plain(hints["off_states"], to_plain(frozenset({"b", "a"}))) == {"a", "b"}


junk = st.recursive(
    st.none() | st.booleans() | st.integers() | numbers | texts,
    lambda inner: (
        st.lists(inner, max_size=4) | st.dictionaries(texts | st.sampled_from(["stamp", "q"]), inner, max_size=4)
    ),
    max_leaves=8,
)


@settings(max_examples=300, deadline=None)
@given(st.sampled_from(sorted(TOPICS)), junk)
def test_junk_is_refused_with_the_place(topic: str, plain: object) -> None:
    with pytest.raises(ValueError):
        from_plain(TOPICS[topic], plain)


@pytest.mark.parametrize("topic", sorted(TOPICS))
def test_every_topic_has_a_schema(topic: str) -> None:
    schema = json_schema(TOPICS[topic])
    assert schema["type"] == "object" and schema["required"] == list(schema["properties"])
    json.dumps(schema, allow_nan=False)


def test_what_has_no_plain_form_is_a_mistake() -> None:
    with pytest.raises(TypeError, match="object"):
        to_plain(object())
