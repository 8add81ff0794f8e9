"""The gate: reads the outgoing frame itself and passes it, or sends a neutral one in its place.

Born closed. It opens on one occasion only: the operator's enable switch, seen let go in a fresh intent, is pressed
while every lever and every valve is neutral and nothing else is wrong. Anything wrong later shuts it, and the switch
has to be let go and pressed again. It shares no code with what computes commands; integers only, no loops beyond the
joints.
"""

from dataclasses import dataclass

from workgauge.values.commands import ValveCommand
from workgauge.values.errors import WireError
from workgauge.values.measurements import Stamp
from workgauge.values.reasons import Reason, ReasonCode
from workgauge.wire.messages import decode_command, encode

#: Sequence numbers count modulo this.
SEQUENCES = 4_294_967_296


@dataclass(frozen=True, slots=True)
class GateConfig:
    """The gate's own limits.

    Attributes:
        machine_id: the only machine whose commands and measurements count.
        source: the name in the frames the gate makes.
        joints: how many valves a command must have.
        valve_limit: largest command either way.
        max_step: (joints,) how much more a valve may open from one frame to the next.
        posture_age_ns, pose_age_ns, intent_age_ns: oldest measurement and intent to move on [ns].
        command_age_ns: oldest frame to pass on [ns].
        exclusive_groups: joint indices of groups of which only one may move at a time.
    """

    machine_id: str
    source: str
    joints: int
    valve_limit: int
    max_step: tuple[int, ...]
    posture_age_ns: int
    pose_age_ns: int
    intent_age_ns: int
    command_age_ns: int
    exclusive_groups: tuple[tuple[int, ...], ...]


@dataclass(frozen=True, slots=True)
class GateFacts:
    """What the gate is told beside the frame: stamps of the newest inputs (None: absent), and the operator's hands.

    Attributes:
        now_ns: the monotonic clock the stamps are counted on [ns].
        enable: the dead-man switch of the newest intent.
        levers_neutral: whether every lever of the newest intent stands in the middle.
    """

    now_ns: int
    posture: Stamp | None
    pose: Stamp | None
    intent: Stamp | None
    enable: bool
    levers_neutral: bool


@dataclass(frozen=True, slots=True)
class GateState:
    """What the gate remembers: everything needed to go on after a restart, born closed.

    Attributes:
        open: whether frames pass.
        released: whether the newest fresh intent showed the enable switch let go.
        valves: the valves last sent, empty before the first frame.
        sequence: the last sequence sent, -1 before the first frame.
    """

    open: bool = False
    released: bool = False
    valves: tuple[int, ...] = ()
    sequence: int = -1


def vet(
    frame: bytes, facts: GateFacts, state: GateState, config: GateConfig
) -> tuple[bytes, GateState, tuple[Reason, ...]]:
    """Return the frame that may go out, the next state, and why the frame was replaced (empty if it was not).

    A refused frame is replaced by a neutral one of the same sequence, or of the expected one if it cannot be read.
    """
    try:
        command = decode_command(frame, facts.now_ns)
    except WireError as error:
        wrong = [Reason(ReasonCode.INVALID_VALUE, f"command frame refused: {error.message}")]
        return _shut(_expected(state), False, facts, config, wrong)
    intent_wrong = _input(facts.intent, "intent", _INTENT, config.intent_age_ns, facts, config)
    wrong = _input(facts.posture, "posture", _POSTURE, config.posture_age_ns, facts, config)
    wrong += _input(facts.pose, "machine pose", _POSE, config.pose_age_ns, facts, config)
    wrong += intent_wrong
    wrong += _origin(command.value, command.sent_ns, facts, state, config)
    wrong += _valves(command.value.valves, state, config)
    if not intent_wrong and not (facts.enable and command.value.enable):
        wrong.append(Reason(ReasonCode.NOT_ENABLED, "enable switch is not pressed"))
    if not wrong and not state.open:
        wrong += _opening(command.value, facts, state)
    if wrong:
        released = not intent_wrong and not facts.enable
        return _shut(command.sequence, released, facts, config, wrong)
    return frame, GateState(True, False, command.value.valves, command.sequence), ()


#: Reason codes of an input that is absent, and too old.
_POSTURE = (ReasonCode.NO_POSTURE, ReasonCode.STALE_POSTURE)
_POSE = (ReasonCode.NO_POSE, ReasonCode.STALE_POSE)
_INTENT = (ReasonCode.NO_INTENT, ReasonCode.STALE_INTENT)


def _input(
    stamp: Stamp | None,
    name: str,
    codes: tuple[ReasonCode, ReasonCode],
    max_age_ns: int,
    facts: GateFacts,
    config: GateConfig,
) -> list[Reason]:
    """Return what is wrong with one input's stamp."""
    if stamp is None:
        return [Reason(codes[0], f"no {name}")]
    if stamp.machine_id != config.machine_id:
        return [Reason(ReasonCode.INVALID_VALUE, f"{name} of another machine, {stamp.machine_id}")]
    age_ns = facts.now_ns - stamp.monotonic_ns
    if age_ns < 0:
        return [Reason(ReasonCode.FROM_FUTURE, f"{name} is stamped in the future")]
    if age_ns > max_age_ns:
        return [Reason(codes[1], f"{name} is too old")]
    return []


def _origin(
    command: ValveCommand, sent_ns: int, facts: GateFacts, state: GateState, config: GateConfig
) -> list[Reason]:
    """Return what is wrong with whose frame this is, when it was made and in which order it came."""
    wrong = []
    if command.stamp.machine_id != config.machine_id:
        wrong.append(Reason(ReasonCode.INVALID_VALUE, f"command for another machine, {command.stamp.machine_id}"))
    age_ns = facts.now_ns - sent_ns
    if age_ns < 0:
        wrong.append(Reason(ReasonCode.FROM_FUTURE, "command is stamped in the future"))
    if age_ns > config.command_age_ns:
        wrong.append(Reason(ReasonCode.WRONG_SEQUENCE, "command is too old"))
    if state.sequence >= 0 and command.sequence != _expected(state):
        wrong.append(
            Reason(ReasonCode.WRONG_SEQUENCE, f"command {command.sequence} follows {state.sequence}, out of order")
        )
    return wrong


def _valves(valves: tuple[int, ...], state: GateState, config: GateConfig) -> list[Reason]:
    """Return what is wrong with the valve openings: count, range, change, groups that cannot move together."""
    if len(valves) != config.joints:
        return [Reason(ReasonCode.INVALID_VALUE, f"command has {len(valves)} valves, the machine {config.joints}")]
    wrong = []
    for joint in range(config.joints):
        valve = valves[joint]
        before = state.valves[joint] if joint < len(state.valves) else 0
        if abs(valve) > config.valve_limit:
            wrong.append(Reason(ReasonCode.OUT_OF_RANGE, f"valve {joint + 1} commanded to {valve}"))
        lowest = min(before, 0) - config.max_step[joint]  # closing is free, and opening counts from the middle
        highest = max(before, 0) + config.max_step[joint]
        if valve < lowest or valve > highest:
            wrong.append(Reason(ReasonCode.TOO_FAST_CHANGE, f"valve {joint + 1} would jump from {before} to {valve}"))
    moving = [group for group in config.exclusive_groups if any(valves[joint] for joint in group)]
    if len(moving) > 1:
        wrong.append(Reason(ReasonCode.EXCLUSIVE_GROUP, "joints that cannot move together are commanded together"))
    return wrong


def _opening(command: ValveCommand, facts: GateFacts, state: GateState) -> list[Reason]:
    """Return why a closed gate does not open on a frame with nothing else wrong."""
    if not state.released:
        return [
            Reason(ReasonCode.GATE_CLOSED, "let the enable switch go, then press it with the levers in the middle")
        ]
    if not facts.levers_neutral or not command.neutral:
        return [Reason(ReasonCode.NOT_NEUTRAL, "levers must be in the middle when the enable switch is pressed")]
    return []


def _shut(
    sequence: int, released: bool, facts: GateFacts, config: GateConfig, wrong: list[Reason]
) -> tuple[bytes, GateState, tuple[Reason, ...]]:
    """Return a neutral frame of that sequence, and the closed state that remembers having sent it."""
    valves = (0,) * config.joints
    stamp = Stamp(config.machine_id, facts.now_ns, config.source)
    neutral = encode(ValveCommand(stamp, sequence, valves, False))
    return neutral, GateState(False, released, valves, sequence), tuple(wrong)


def _expected(state: GateState) -> int:
    """Return the sequence that follows the last one sent."""
    return (state.sequence + 1) % SEQUENCES
