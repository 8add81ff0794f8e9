"""What the tick remembers, and its plain form that goes through JSON unchanged."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from workgauge.gate.gate import GateState
from workgauge.guard.api import Memory
from workgauge.loop.config import TickConfig
from workgauge.motion.desired import MotionMemory
from workgauge.motion.job import JobMemory
from workgauge.values.errors import InputError


@dataclass(frozen=True, slots=True)
class TickMemory:
    """Everything a tick hands to the next.

    Attributes:
        sequence: of the next command.
        valves: (n) the valves that really went out last.
        motion: levers after the ramp, the line being followed.
        guard: what the guard wants to remember.
        gate: open or closed, and what it last sent.
        at_ns: the clock of the tick, None before the first [ns].
        job: how far automatic motion is.
    """

    sequence: int
    valves: tuple[int, ...]
    motion: MotionMemory
    guard: Memory
    gate: GateState
    at_ns: int | None = None
    job: JobMemory = field(default_factory=JobMemory)

    def plain(self) -> dict[str, Any]:
        """Return the memory as dicts, lists, numbers and strings."""
        return {
            "sequence": self.sequence,
            "valves": list(self.valves),
            "motion": {name: _listed(value) for name, value in asdict(self.motion).items()},
            "guard": {name: _listed(value) for name, value in self.guard.items()},
            "gate": {name: _listed(value) for name, value in asdict(self.gate).items()},
            "at_ns": self.at_ns,
            "job": self.job.plain(),
        }


def first_memory(config: TickConfig) -> TickMemory:
    """Return the memory before the first tick: valves closed, gate closed."""
    return TickMemory(0, (0,) * config.machine.n, MotionMemory(), config.guard.start(), GateState())


def restored(plain: Mapping[str, Any]) -> TickMemory:
    """Return the memory whose `plain` form this is; a run goes on from it bit for bit.

    Raises:
        InputError: if it is not such a form.
    """
    try:
        return TickMemory(
            sequence=int(plain["sequence"]),
            valves=tuple(int(valve) for valve in plain["valves"]),
            motion=MotionMemory(**{name: _tupled(value) for name, value in plain["motion"].items()}),
            guard=dict(plain["guard"]),
            gate=GateState(**{name: _tupled(value) for name, value in plain["gate"].items()}),
            at_ns=None if plain["at_ns"] is None else int(plain["at_ns"]),
            job=JobMemory.of(plain["job"]),
        )
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise InputError("not a tick's memory", element="memory", value=str(error)) from None


def _listed(value: object) -> object:
    """Return a value with arrays, tuples and numpy's numbers, however deep, as lists and Python's own."""
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    if isinstance(value, Mapping):
        return {name: _listed(one) for name, one in value.items()}
    return [_listed(one) for one in value] if isinstance(value, tuple | list) else value


def _tupled(value: Any) -> Any:
    return tuple(value) if isinstance(value, list) else value
