"""The ramp: valves open gradually and close at once."""

from collections.abc import Sequence


def ramped(
    previous: Sequence[int],
    wanted: Sequence[int],
    max_step: Sequence[int],
    jump: Sequence[tuple[int, int]] | None = None,
) -> tuple[int, ...]:
    """Return `wanted` (n), scaled as a whole and rounded towards zero so that no valve opens by more than its step.

    Closing is free; a valve that changes sides starts from the middle. Scaling all valves alike keeps the direction
    of the motion, which a guard may have chosen with care: a joint that lags would let another's approach through.
    What a valve jumps over counts neither as opening nor as motion: steps and scale are of what lies beyond.

    Args:
        previous: (n) the valves sent last. wanted: (n). max_step: (n) largest opening per tick, above 0.
        jump: (n) openings (positive, negative side) that do not move yet; none if left out.
    """
    jumps = [(0, 0)] * len(wanted) if jump is None else jump
    numerator, denominator = 1, 1
    for before, valve, step, (up, down) in zip(previous, wanted, max_step, jumps, strict=True):
        if not valve:
            continue
        room = step + (max(before - up, 0) if valve > 0 else max(-before - down, 0))
        beyond = valve - up if valve > 0 else -valve - down
        if beyond * numerator > room * denominator:
            numerator, denominator = room, beyond
    return tuple(
        (_scaled(valve, up, numerator, denominator) if valve > 0 else -_scaled(-valve, down, numerator, denominator))
        if valve
        else 0
        for valve, (up, down) in zip(wanted, jumps, strict=True)
    )


def _scaled(opening: int, jump: int, numerator: int, denominator: int) -> int:
    """Return an opening, 0 or above, with what lies beyond its jump scaled; one that would not move is closed."""
    beyond = max(opening - jump, 0) * numerator // denominator
    return jump + beyond if beyond else 0
