"""The ramp: valves open gradually and close at once."""

from collections.abc import Sequence


def ramped(previous: Sequence[int], wanted: Sequence[int], max_step: Sequence[int]) -> tuple[int, ...]:
    """Return `wanted` (n), scaled as a whole and rounded towards zero so that no valve opens by more than its step.

    Closing is free; a valve that changes sides starts from the middle. Scaling all valves alike keeps the direction
    of the motion, which a guard may have chosen with care: a joint that lags would let another's approach through.

    Args:
        previous: (n) the valves sent last. wanted: (n). max_step: (n) largest opening per tick, above 0.
    """
    numerator, denominator = 1, 1
    for before, valve, step in zip(previous, wanted, max_step, strict=True):
        room = step + (max(before, 0) if valve > 0 else max(-before, 0))
        if abs(valve) * numerator > room * denominator:
            numerator, denominator = room, abs(valve)
    return tuple(
        valve * numerator // denominator if valve > 0 else -(-valve * numerator // denominator) for valve in wanted
    )
