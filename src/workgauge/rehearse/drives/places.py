"""Where drives take place: on a site at random, or among limits drawn at random."""

import math
from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from workgauge.gauge.build import LimitSet, build_limits
from workgauge.gauge.own_track import without_own_track
from workgauge.gauge.rules import RuleBook
from workgauge.machine.model import MachineModel
from workgauge.proximity.scene import Scene
from workgauge.rehearse.drives.clutter import clutter
from workgauge.rehearse.scenario import OnGround, OnTrack
from workgauge.rehearse.start import stand
from workgauge.site.model import SiteModel
from workgauge.values.arrays import Floats, frozen
from workgauge.values.errors import InputError
from workgauge.values.limits import Limit
from workgauge.values.transforms import rpy

#: A machine that does not run on rails stands this far beside a track [m].
BESIDE_M = (3.0, 9.0)


@dataclass(frozen=True, eq=False)
class Place:
    """Limits, and a machine among them.

    Attributes:
        scene: what the guard looks at. truth: the same limits, looked at by nobody but the truth.
        T_site_machine: (4, 4) true pose of the undercarriage.
        words: where that is.
    """

    scene: Scene
    truth: Scene
    T_site_machine: Floats
    words: str

    def with_machine(self, machine: MachineModel) -> "Place":
        """Return the same place with another machine of the same shape in the guard's eyes.

        Its scene shares every collision shape with this one.
        """
        scene = copy(self.scene)
        scene.machine = machine
        return replace(self, scene=scene)


class SitePlaces:
    """Random places on one site; limits are built once, in the frame of the site's middle.

    Args:
        site, rules: what makes the limits. machine: what stands there.
    """

    def __init__(self, site: SiteModel, rules: RuleBook, machine: MachineModel) -> None:
        self._site, self._rules, self._machine = site, rules, machine
        self._frame = site.frame()
        self._scenes: dict[str | None, tuple[Scene, Scene]] = {}

    @cached_property
    def _limit_set(self) -> LimitSet:
        return build_limits(self._site, self._rules, self._frame)

    def draw(self, rng: np.random.Generator) -> Place:
        """Return a random place.

        Raises:
            InputError: if the site has no alignment to stand on or beside.
        """
        if not self._site.alignments:
            raise InputError("no alignment to stand on or beside", element="site")
        alignment = self._site.alignments[int(rng.integers(len(self._site.alignments)))]
        end = min(20.0, 0.1 * alignment.length)
        along = float(rng.uniform(end, alignment.length - end))
        turned, offset = rng.random() < 0.5, float(rng.uniform(*BESIDE_M)) * float(rng.choice([-1.0, 1.0]))
        heading = float(rng.uniform(-math.pi, math.pi))
        place: OnTrack | OnGround
        if self._machine.undercarriage.kind == "rail":
            facing = "backward" if turned else "forward"
            place = OnTrack(alignment=alignment.name, distance_m=along, facing=facing)  # type: ignore[arg-type]
        else:
            state = alignment.at([along])
            direction, e, n = float(state.heading[0]), float(state.e[0]), float(state.n[0])
            east, north = e - offset * math.cos(direction), n + offset * math.sin(direction)
            place = OnGround(east_m=east, north_m=north, heading_deg=math.degrees(heading))
        stood = stand(self._site, self._rules, self._machine, place)
        T = np.array(stood.T_absolute_machine)
        T[:3, 3] = self._frame.to_local(T[:3, 3])
        return Place(*self._of(stood.own_track), frozen(T), stood.words)

    def _of(self, own_track: str | None) -> tuple[Scene, Scene]:
        if own_track not in self._scenes:
            limits = without_own_track(self._limit_set, own_track)
            self._scenes[own_track] = Scene(self._machine, limits), Scene(self._machine, limits)
        return self._scenes[own_track]


class RandomPlaces:
    """Limits drawn at random round the machine, see `clutter`."""

    def __init__(self, machine: MachineModel) -> None:
        self._machine = machine

    def draw(self, rng: np.random.Generator) -> Place:
        """Return a random place."""
        limits: Sequence[Limit] = clutter(rng, self._machine)
        tilt, yaw = rng.uniform(-0.1, 0.1, 2), float(rng.uniform(-math.pi, math.pi))
        T = np.eye(4)
        T[:3, :3] = rpy(float(tilt[0]), float(tilt[1]), yaw)[:3, :3]
        return Place(Scene(self._machine, limits), Scene(self._machine, limits), frozen(T), "among random limits")
