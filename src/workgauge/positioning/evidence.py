"""What the health of a position is judged from, and what the judge remembers between ticks."""

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

from workgauge.values.errors import InputError
from workgauge.values.health import HealthState
from workgauge.values.navigation import FixQuality


@dataclass(frozen=True, slots=True)
class HealthSeen:
    """What was observed by one tick. NaN, None and empty mean that nothing was observed, never that all is well.

    Attributes:
        now_ns: the tick's clock [ns].
        fix_age_s: age of the newest accepted solution's epoch, before this tick's is judged; inf if there is none.
        quality: of this tick's solution; without one it is not looked at, the newest accepted one's counts on.
        sigma_m: largest horizontal 1-sigma of the pose now. correction_age_s: of the differential correction.
        innovation: this tick's solution against the pose carried on, in sigmas (`positioning.innovation`); NaN if
            there is no new solution, 0 for the very first, which has nothing to be compared with.
        baseline_error_m: measured less known distance of the antennas. baseline_sigma_m: its 1-sigma.
        heading_difference: two headings, or heading and course, (-pi, pi] [rad]; NaN while they cannot be compared.
        heading_sigma: 1-sigma of that difference [rad].
        swapped: the antennas are exchanged (`positioning.headings`).
        same_for_s: coordinates exactly unchanged for so long while sentences keep coming.
        moving_wheels: whether the undercarriage is known to travel, None if nothing says so.
        speed_m_s: last known speed of the undercarriage over ground.
        stale_sensors: link sensors that are missing or old. jumped_joints: joints whose reading jumped.
        checked: whether the start-of-shift check holds, None if none is asked for.
        agreement: this tick's solution against the last refused one carried on, in sigmas; NaN if there is none.
        new_age_s: age of this tick's solution's epoch, NaN if there is none.
    """

    now_ns: int
    fix_age_s: float = math.inf
    quality: FixQuality = FixQuality.NONE
    sigma_m: float = math.nan
    correction_age_s: float = math.nan
    innovation: float = math.nan
    baseline_error_m: float = math.nan
    heading_difference: float = math.nan
    swapped: bool = False
    same_for_s: float = 0.0
    moving_wheels: bool | None = None
    speed_m_s: float = math.nan
    stale_sensors: tuple[str, ...] = ()
    jumped_joints: tuple[str, ...] = ()
    checked: bool | None = None
    baseline_sigma_m: float = math.nan
    heading_sigma: float = math.nan
    agreement: float = math.nan
    new_age_s: float = math.nan

    @property
    def new(self) -> bool:
        """Whether a solution arrived this tick."""
        return not math.isnan(self.innovation)


@dataclass(frozen=True, slots=True)
class HealthMemory:
    """What the judge hands to the next tick, plain values only.

    Attributes:
        state, since_ns: the state and when it was entered.
        now_ns: clock of the last tick, -1 before the first.
        trusted_ns: epoch of the newest accepted solution on the tick's clock, None without one.
        quality: of that solution.
        agreeing: accepted solutions in a row with nothing wrong between them, counted up to the number asked for.
        fixed: those of them in a row with ambiguities fixed and a fresh correction.
        jump_sigmas: by how much the newest solution jumped, 0 if it did not.
        candidates: refused solutions in a row that agree with each other.
        heading_wrong: by how much a heading disagreed, 0 once one agrees [rad]. baseline_wrong: the baseline [m].
        heading_allowed, baseline_allowed: what each was held to, honest noise included.
        swapped: antennas found exchanged, and no heading has agreed since.
        moved: the undercarriage moved, or was not known to stand, when it had to.
    """

    state: HealthState = HealthState.STOP
    since_ns: int = 0
    now_ns: int = -1
    trusted_ns: int | None = None
    quality: FixQuality = FixQuality.NONE
    agreeing: int = 0
    fixed: int = 0
    jump_sigmas: float = 0.0
    candidates: int = 0
    heading_wrong: float = 0.0
    baseline_wrong: float = 0.0
    heading_allowed: float = 0.0
    baseline_allowed: float = 0.0
    swapped: bool = False
    moved: bool = False

    def plain(self) -> dict[str, Any]:
        """Return the memory as numbers, strings and None: the keywords of `remembered`."""
        return {**asdict(self), "state": self.state.value, "quality": self.quality.value}


def remembered(plain: Mapping[str, Any]) -> HealthMemory:
    """Return the memory whose `plain` form this is.

    Raises:
        InputError: if it is not such a form.
    """
    try:
        return HealthMemory(
            **{**plain, "state": HealthState(plain["state"]), "quality": FixQuality(plain["quality"])}
        )
    except (KeyError, TypeError, ValueError) as error:
        raise InputError("not a health memory", element="memory", value=str(error)) from None
