"""One random drive: everything about it is settled by its seed before any guard is asked."""

from dataclasses import dataclass, field

import numpy as np

from workgauge.gauge.rules import RuleBook
from workgauge.machine.model import MachineModel
from workgauge.motion.joystick import LeverFeel
from workgauge.rehearse.drives.dynamics import Dynamics, believed_machine, true_hydraulics
from workgauge.rehearse.drives.levers import DRIVE_KINDS, SLID_ALONG, DriveKind, Operator, Programme, drawn_kind
from workgauge.rehearse.drives.places import Place, RandomPlaces, SitePlaces
from workgauge.sim.hydraulics import HydraulicSpec
from workgauge.site.model import SiteModel
from workgauge.values.arrays import Floats, frozen
from workgauge.values.errors import InputError, ScenarioError
from workgauge.values.transforms import rotation

#: A drive begins at least this much farther from every limit than the stop distance [m]. So do links from each other,
#: but where a small machine has no such posture, they make do with less, down to the other.
START_ROOM_M, START_OWN_ROOM_M = 0.3, 0.02
#: It begins no farther than this from some limit, if such a posture is found [m].
START_NEAR_M = 1.5
#: Postures tried at one place, and places tried for one drive.
_POSTURES, _PLACES = 60, 40
#: Parts of a drive that draw numbers of their own, so that none depends on how many another takes.
_PLACE, _HANDS, _OIL, _DOUBT = range(4)


@dataclass(frozen=True, slots=True)
class Doubt:
    """How unsure pose and posture are: 1-sigma; the guard is told, and the errors of a drive are drawn from it.

    Attributes:
        position_m: of the machine along each axis. angle_rad: of its attitude about each axis. joint: of every joint.
    """

    position_m: float = 0.0
    angle_rad: float = 0.0
    joint: float = 0.0


@dataclass(frozen=True, slots=True)
class DriveSettings:
    """What all drives of a batch share.

    Attributes:
        dynamics: of the joints. seconds: of lever work per drive; after it every lever is let go, to rest.
        dt_s: the tick's period. substeps: looks at the truth per tick, where it matters.
        stop_distance_m: smallest clearance, for limits without one of their own: what the guards are told.
        kinds: of drives. gate_closes: share of drives in which the gate closes at random instants.
        random_places: share of drives among random limits; the others are on the site.
        doubt: of pose and posture. tool_speed_m_s: at the full lever where levers move the tool.
        radius_m: how far the tick looks.
        near_m: the truth is told by kind of limit and link for clearances within this of their stop distance.
    """

    dynamics: Dynamics = field(default_factory=Dynamics)
    seconds: float = 4.0
    dt_s: float = 0.02
    substeps: int = 4
    stop_distance_m: float = 0.2
    kinds: tuple[DriveKind, ...] = DRIVE_KINDS
    gate_closes: float = 0.3
    random_places: float = 0.5
    doubt: Doubt = field(default_factory=Doubt)
    tool_speed_m_s: float = 1.0
    radius_m: float = 7.0
    near_m: float = 1.0

    def __post_init__(self) -> None:
        unknown = [kind for kind in self.kinds if kind not in DRIVE_KINDS]
        for name, fine, allowed in (
            ("seconds", 0.1 <= self.seconds <= 600.0, "0.1 to 600 s"),
            ("dt_s", 1e-3 <= self.dt_s <= 0.2, "0.001 to 0.2 s"),
            ("substeps", 1 <= self.substeps <= 100, "1 to 100"),
            ("stop_distance_m", 0.0 <= self.stop_distance_m <= 10.0, "0 to 10 m"),
            ("kinds", bool(self.kinds) and not unknown, ", ".join(DRIVE_KINDS)),
            ("near_m", 0.0 <= self.near_m <= 10.0, "0 to 10 m"),
            ("gate_closes", 0.0 <= self.gate_closes <= 1.0, "0 to 1"),
            ("random_places", 0.0 <= self.random_places <= 1.0, "0 to 1"),
        ):
            if not fine:
                raise InputError("out of range", element=name, value=getattr(self, name), allowed=allowed)


@dataclass(frozen=True, eq=False)
class Drive:
    """One drive, the same for every guard.

    Attributes:
        seed, kind: what it was drawn as. place: the limits, and where the machine stands.
        machine: as the guard is told it is, its stopping included. hydraulics: how its joints really are.
        q: (n,) start posture. programme: what the operator does.
        T_error: (4, 4), rotation and translation in the site frame that the believed pose is off the true one.
        q_error: (n,) that the believed posture is off the true one.
        settings: of its batch.
    """

    seed: int
    kind: DriveKind
    place: Place
    machine: MachineModel
    hydraulics: HydraulicSpec
    q: Floats
    programme: Programme
    T_error: Floats
    q_error: Floats
    settings: DriveSettings


class Drives:
    """Draws drives of one machine; what they share is made once.

    Args:
        machine: which one. site, rules: of the drives on a site; without them all are among random limits.
    """

    def __init__(self, machine: MachineModel, site: SiteModel | None = None, rules: RuleBook | None = None) -> None:
        if (site is None) != (rules is None):
            raise InputError("a site and a rule book belong together", element="rules")
        self.machine = machine
        self._site = None if site is None or rules is None else SitePlaces(site, rules, machine)
        self._random = RandomPlaces(machine)

    def draw(self, seed: int, settings: DriveSettings) -> Drive:
        """Return the drive of a seed.

        Place, start posture and levers depend on the seed and on `seconds`, `stop_distance_m`, `kinds`,
        `gate_closes` and `random_places`, not on the dynamics.

        Where no place on the site leaves the arm any room, the drive is among random limits instead.

        Raises:
            ScenarioError: if no posture clear of everything is found there either.
        """
        hands = np.random.default_rng((seed, _HANDS))
        kind = drawn_kind(hands, settings.kinds)
        place, q = self._start(np.random.default_rng((seed, _PLACE)), kind, settings)
        operator = Operator(self.machine, place.scene, place.T_site_machine, q, LeverFeel())
        programme = operator.programme(kind, settings.seconds, hands.random() < settings.gate_closes, hands)
        oil = np.random.default_rng((seed, _OIL))
        machine = believed_machine(self.machine, settings.dynamics, oil)
        hydraulics = true_hydraulics(machine, settings.dynamics, oil)
        doubt, errors = settings.doubt, np.random.default_rng((seed, _DOUBT))
        T_error = np.eye(4)
        T_error[:3, 3] = doubt.position_m * errors.normal(size=3)
        T_error[:3, :3] = rotation(doubt.angle_rad * errors.normal(size=3))
        q_error = frozen(doubt.joint * errors.normal(size=machine.n))
        place = place.with_machine(machine)
        return Drive(seed, kind, place, machine, hydraulics, q, programme, frozen(T_error), q_error, settings)

    def _start(self, rng: np.random.Generator, kind: DriveKind, settings: DriveSettings) -> tuple[Place, Floats]:
        """Return a place and a posture there, clear of everything and near what the kind of drive is about."""
        sources: list[SitePlaces | RandomPlaces] = [self._random]
        if self._site is not None and rng.random() >= settings.random_places:
            sources.insert(0, self._site)
        for source in sources:
            for _ in range(_PLACES):
                place = source.draw(rng)
                q = _clear_posture(rng, self.machine, place, kind, settings.stop_distance_m)
                if q is not None:
                    return place, q
        raise ScenarioError(
            "no posture clear of everything was found", element="drive", value=f"{_PLACES} places tried"
        )


def _clear_posture(
    rng: np.random.Generator, machine: MachineModel, place: Place, kind: DriveKind, stop_distance_m: float
) -> Floats | None:
    """Return the first random posture that is clear of everything and near a limit, or else the nearest clear one.

    For a sliding drive that limit is a track's envelope, if there is one.
    """
    best: tuple[float, Floats] | None = None
    limits = place.truth.limits
    sought = np.array([kind != "sliding" or limit.kind is SLID_ALONG for limit in limits], dtype=np.bool_)
    sought = sought if sought.any() else np.ones(len(limits), dtype=np.bool_)
    for k in range(_POSTURES):
        anywhere = rng.uniform(machine.sample_min, machine.sample_max)
        q = frozen(anywhere if k % 2 == 0 else machine.home + rng.random() * (anywhere - machine.home))
        found = place.truth.query(machine.forward(q), place.T_site_machine, 2.0 * START_NEAR_M)
        own = found.stop_distances
        room = found.distances - np.where(np.isnan(own), stop_distance_m, own)
        own_links, own_room = found.other_links >= 0, max(START_ROOM_M * (1.0 - k / _POSTURES), START_OWN_ROOM_M)
        if (room < np.where(own_links, own_room, START_ROOM_M)).any():
            continue
        outside = room[~own_links]
        outside = outside[sought[found.limits[~own_links]]]
        nearest = float(outside.min()) if outside.size else 2.0 * START_NEAR_M
        if best is None or nearest < best[0]:
            best = nearest, q
        if nearest < START_NEAR_M:
            break
    return None if best is None else best[1]
