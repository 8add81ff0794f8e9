"""What a guard remembers may hold arrays: it goes through JSON, and a run goes on from there bit for bit."""

import json
import math
from typing import Any

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from workgauge.gate.gate import GateState
from workgauge.loop.memory import TickMemory, restored
from workgauge.motion.desired import MotionMemory

arrays = hnp.arrays(np.float64, hnp.array_shapes(max_dims=3, max_side=4), elements=st.floats(width=64))
remembered = st.dictionaries(
    st.sampled_from(["sent", "speeds", "marks"]),
    st.one_of(
        arrays,
        hnp.arrays(np.int64, (3,)),
        st.tuples(arrays, st.integers(), st.text(max_size=3)),
        st.dictionaries(st.sampled_from("ab"), arrays),
        st.floats().map(np.float64),
        st.none(),
    ),
)


def same(value: Any, plain: Any) -> bool:
    """Return whether a plain form holds the same bits."""
    if isinstance(value, np.ndarray):
        back = np.array(plain, dtype=value.dtype).reshape(value.shape)
        return bool(
            np.isnan(value).tolist() == np.isnan(back).tolist()
            and (np.nan_to_num(value) == np.nan_to_num(back)).all()
        )
    if isinstance(value, dict):
        return set(value) == set(plain) and all(same(value[key], plain[key]) for key in value)
    if isinstance(value, tuple):
        return len(value) == len(plain) and all(same(one, other) for one, other in zip(value, plain, strict=True))
    if isinstance(value, float) and math.isnan(value):
        return math.isnan(plain)
    return bool(value == plain)


@settings(max_examples=150, deadline=None)
@given(remembered)
def test_arrays_in_a_guards_memory_survive_json(guard: dict[str, Any]) -> None:
    memory = TickMemory(3, (1, -2), MotionMemory(), guard, GateState(True, False, (1, -2), 3), 40)
    text = json.dumps(memory.plain())
    again = restored(json.loads(text))
    assert same(guard, again.guard) and json.dumps(again.plain()) == text
    assert (again.sequence, again.valves, again.motion, again.gate, again.at_ns) == (
        *(memory.sequence, memory.valves, memory.motion, memory.gate, memory.at_ns),
    )
