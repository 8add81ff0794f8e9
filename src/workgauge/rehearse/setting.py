"""What a session is about: a machine at a place of a site, a rule book, a guard, and what follows from them."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path
from types import MappingProxyType

import numpy as np

from workgauge.gauge.build import LimitSet, build_limits
from workgauge.gauge.following import OnTracks, TrackFollower
from workgauge.gauge.rulebook import load_rule_book
from workgauge.gauge.rules import RuleBook
from workgauge.gauge.suspending import IN_FORCE, suspendable
from workgauge.geodesy.frame import SiteFrame
from workgauge.guard.api import Guard
from workgauge.guard.travel import Brakes
from workgauge.loop.config import TickConfig, search_radius_m, tick_config
from workgauge.machine.load import load_machine
from workgauge.machine.model import MachineModel
from workgauge.motion.desired import MotionConfig
from workgauge.motion.wish import FollowSettings
from workgauge.proximity.scene import Scene
from workgauge.rehearse.choices import chosen_files, chosen_guard, chosen_place, chosen_posture
from workgauge.rehearse.hydraulic_choice import Joints
from workgauge.rehearse.joints import Moving, moving
from workgauge.rehearse.posture import LetOff, start_posture
from workgauge.rehearse.scenario import OnGround, OnTrack
from workgauge.rehearse.start import Stand, stand
from workgauge.rehearse.targets import nearest_point
from workgauge.rehearse.ways import GroundPlace, RailPlace, way_from
from workgauge.site.model import SiteModel
from workgauge.site.read import read_site
from workgauge.values.arrays import Floats
from workgauge.values.errors import ScenarioError
from workgauge.values.limits import Limit
from workgauge.values.transforms import heading_from_yaw
from workgauge.wire.messages import NAME_BYTES

#: The shipped site, and the rule book it is built to.
SHIPPED_SITE, SHIPPED_SITE_RULES = "double_track", "finland"

#: A start posture takes the nearest pole into account up to this far away [m].
POLE_WITHIN_M = 15.0

#: Oldest intent to move on [s], unless told otherwise.
INTENT_AGE_S = 0.2

#: How far the tick looks: more than a full-speed stop of a 20 t machine (6.7 m).
TICK_RADIUS_M = 7.0


@dataclass(frozen=True, slots=True, eq=False)
class Setting:
    """A machine at a place of a site, and what follows from it; all of it at the start, whatever a session does.

    Attributes:
        site, machine, rules, guard: loaded. tick_s: tick period [s]. brakes: of the undercarriage.
        moving: what moves the joints, whose state goes on with them.
        start_utc: UTC at the start of the simulated time.
        stand: where the machine stands at the start. frame: the site's local frame, near there.
        limit_set: in that frame. names: limit id to what a person calls it.
        scene: the limits around the machine, as the tick is given them.
        place: where it stands, ready to travel from. follower: on which tracks a machine stands.
        on_tracks: what it stands on at the start.
    """

    site: SiteModel
    machine: MachineModel
    rules: RuleBook
    guard: Guard
    tick_s: float
    brakes: Brakes
    moving: Moving
    start_utc: datetime
    stand: Stand
    frame: SiteFrame
    limit_set: LimitSet
    names: Mapping[str, str]
    scene: Scene
    place: RailPlace | GroundPlace
    follower: TrackFollower
    on_tracks: OnTracks

    @property
    def T_site_machine(self) -> Floats:
        """Where the machine stands at the start, in the site's local frame (4, 4)."""
        return self.place.T_site_machine

    @property
    def machine_id(self) -> str:
        """The machine's name as its messages bear it."""
        return self.machine.name.encode()[:NAME_BYTES].decode(errors="ignore")

    @property
    def states(self) -> frozenset[str]:
        """The work states that limits of the site depend on; what a supervisor may suspend is not among them."""
        states = (limit.activity.state for limit in self.limit_set.limits)
        return frozenset(state for state in states if state is not None and not state.startswith(IN_FORCE))

    def check_state(self, name: str) -> None:
        """Refuse the name of a work state that no limit of the site depends on.

        Raises:
            ScenarioError: if it is one, naming those there are.
        """
        if name not in self.states:
            known = ", ".join(repr(state) for state in sorted(self.states)) or "none, no limit depends on a state"
            raise ScenarioError("no limit depends on such a state", element="state", value=name, allowed=known)

    def limits(self, let_off: frozenset[str]) -> tuple[Limit, ...]:
        """Return the limits of the site, without the envelopes of tracks the machine is let off."""
        return tuple(limit for limit in self.limit_set.limits if limit.own_track_of not in let_off)

    def standing_on(self, before: OnTracks, T_site_machine: Floats) -> OnTracks:
        """Return what a machine at this pose stands on, that stood on `before`."""
        return _standing_on(self.follower, self.frame, before, T_site_machine)

    def posture(self, asked: Mapping[str, float] | None) -> Floats:
        """Return the start posture (n,): the joints asked for, home elsewhere.

        Without any asked for: home, or a posture clear of the nearest pole that the machine could be driven at.

        Raises:
            ScenarioError: for an unknown joint or a position beyond its limits.
        """
        if asked is not None:
            return chosen_posture(self.machine, asked)
        T, let_off = self.T_site_machine, self.on_tracks.let_off
        near = nearest_point(self.limits(let_off), T[:3, 3])
        away = math.inf if near is None else float(np.linalg.norm((near - T[:3, 3])[:2]))
        return start_posture(LetOff(self.scene, let_off), T, near if away < POLE_WITHIN_M else None)

    def tick_config(
        self, follow: FollowSettings | None, tool_sigma_m: float | None, intent_age_s: float = INTENT_AGE_S
    ) -> TickConfig:
        """Return the configuration of the tick.

        Args:
            follow: how automatic motion does its jobs; left out, as fits the joints.
            tool_sigma_m, intent_age_s: as of `loop.config.tick_config`.
        """
        return tick_config(
            self.machine,
            self.guard,
            machine_id=self.machine_id,
            dt_s=self.tick_s,
            radius_m=max(TICK_RADIUS_M, search_radius_m(self.guard, self.limit_set.limits)),
            tool_sigma_m=tool_sigma_m,
            intent_age_s=intent_age_s,
            drive=self.moving.drive,
            motion=MotionConfig(follow=follow or FollowSettings(compensate=self.moving.late)),
        )


def setting_of(
    site: SiteModel | str | Path | Sequence[str | Path],
    machine: MachineModel | str | Path,
    rules: RuleBook | str | Path | None,
    guard: Guard | str,
    at: tuple[float, float, float] | OnTrack | OnGround | None,
    *,
    attachment: str | None,
    guard_parameters: Mapping[str, float | str] | None,
    tick_s: float,
    epsg: int | None,
    brakes: Brakes | None,
    joints: Joints,
    start_utc: datetime,
) -> Setting:
    """Return the setting of a session, from what people hand in; see `Session` for each of them.

    Raises:
        InputError: for anything that cannot be used.
    """
    read = site if isinstance(site, SiteModel) else read_site(chosen_files(site), epsg=epsg)
    model = machine if isinstance(machine, MachineModel) else load_machine(machine, attachment)
    if rules is None:
        rules = SHIPPED_SITE_RULES if site == SHIPPED_SITE else "generic"
    book = rules if isinstance(rules, RuleBook) else load_rule_book(rules)
    chosen = chosen_guard(guard, guard_parameters or {}) if isinstance(guard, str) else guard
    moves = moving(joints, model)
    asked = chosen_place(at, read)
    stood = stand(read, book, model, asked)
    east, north, up = stood.T_absolute_machine[:3, 3].tolist()
    frame = read.frame((east, north, up))
    built = build_limits(read, book, frame, start_utc)
    limit_set = replace(built, limits=suspendable(built.limits, book))
    names = MappingProxyType({limit.id: limit.name for limit in limit_set.limits})
    scene = Scene(model, limit_set.limits)
    place = way_from(read, book, model, frame, asked, stood)
    follower = TrackFollower(read, book)
    on_tracks = _standing_on(follower, frame, OnTracks(stood.own_track), place.T_site_machine)
    return Setting(
        *(read, model, book, chosen, tick_s, brakes or Brakes(), moves, start_utc),
        *(stood, frame, limit_set, names, scene, place, follower, on_tracks),
    )


def _standing_on(follower: TrackFollower, frame: SiteFrame, before: OnTracks, T_site_machine: Floats) -> OnTracks:
    east, north = frame.to_absolute(T_site_machine[:3, 3])[:2]
    heading = heading_from_yaw(math.atan2(T_site_machine[1, 0], T_site_machine[0, 0]))
    return follower.follow(before, float(east), float(north), heading)
