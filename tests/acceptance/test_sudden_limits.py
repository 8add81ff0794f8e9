"""What changes suddenly around a machine: a limit switched on, a jump of position, a limit that moves.

One guard and one scene see all of it in one run, so that anything kept from before would show. Never a speed towards
what is violated; and what one tick answers does not hang on what an earlier one saw.
"""

from typing import Any

import numpy as np
import pytest

from workgauge.guard.registry import guard_named
from workgauge.loop.config import search_radius_m, tick_config
from workgauge.loop.inputs import TickInputs
from workgauge.loop.memory import first_memory
from workgauge.loop.tick import tick
from workgauge.machine.load import load_machine
from workgauge.proximity.scene import Scene
from workgauge.rehearse.drives.dynamics import IDEAL, Dynamics, believed_machine, true_hydraulics
from workgauge.sim.joints import HydraulicJoints
from workgauge.values.arrays import frozen
from workgauge.values.limits import Activity, Limit, LimitKind, Source
from workgauge.values.measurements import Intent, Levers, MachinePose, Posture, Stamp
from workgauge.values.solids import Box

DT_S = 0.02
STOP_M = 0.2
#: Speeds below this are the valves' whole steps and the rounding of bounds [m/s].
NO_SPEED_M_S = 1e-4
LATE = Dynamics(dead_time_s=0.3, lag_s=0.2, stop_s=0.6)


def box_limit(centre: Any, half: Any, *, velocity: Any = None, state: str | None = None) -> Limit:
    T = np.eye(4)
    T[:3, 3] = centre
    more = {} if velocity is None else {"velocity": frozen(velocity)}
    source = Source("test", "box")
    return Limit(
        "box", LimitKind.ZONE, "box", Box(frozen(T), frozen(half)), "test", source, activity=Activity(state), **more
    )


class Site:
    """A machine before the tick, its joints true, its levers held by whoever asks."""

    def __init__(self, dynamics: Dynamics = IDEAL) -> None:
        rng = np.random.default_rng(0)
        self.machine = believed_machine(load_machine("rre20"), dynamics, rng)
        self.plant = HydraulicJoints(self.machine, true_hydraulics(self.machine, dynamics, rng))
        guard = guard_named("barrier")
        self.config = tick_config(
            self.machine,
            guard,
            machine_id="m",
            dt_s=DT_S,
            radius_m=max(6.0, search_radius_m(guard, ())),
            tool_sigma_m=0.0,
        )
        self.memory, self.q, self.k = first_memory(self.config), np.array(self.machine.home), 0
        self.T = np.eye(4)
        self.trace: Any = None

    def inputs(self, scene: Scene, levers: Levers, off: frozenset[str]) -> TickInputs:
        now = round(self.k * DT_S * 1e9)
        stamp = Stamp("m", now, "test", now)
        intent = Intent(stamp, levers=levers if self.k > 1 else Levers(), enable=self.k > 0)
        pose = MachinePose.exact(stamp, frozen(self.T))
        return TickInputs(now, Posture.exact(stamp, self.q), pose, intent, scene, off)

    def tick(self, scene: Scene, levers: Levers, off: frozenset[str] = frozenset()) -> Any:
        _, self.memory, self.trace = tick(self.inputs(scene, levers, off), self.memory, self.config)
        self.plant.set_valves(self.memory.valves)
        self.q = self.plant.advance(DT_S, self.q)
        self.k += 1
        return self.trace

    def slack(self, scene: Scene, off: frozenset[str] = frozenset()) -> float:
        found = scene.query(self.machine.forward(self.q), self.T, 6.0, off_states=off)
        return float(found.distances[found.other_links < 0].min(initial=6.0)) - STOP_M

    def towards(self, scene: Scene) -> float:
        """Return how fast the arm comes nearer to the nearest limit by what was just commanded [m/s]."""
        q0 = self.trace.q
        nearer = []
        for q in (q0, q0 + 1e-4 * self.trace.allowed):
            found = scene.query(self.machine.forward(q), self.T, 6.0)
            nearer.append(float(found.distances[found.other_links < 0].min(initial=6.0)))
        return (nearer[0] - nearer[1]) / 1e-4

    def tool(self) -> Any:
        return (self.T @ self.machine.tool_pose(self.machine.forward(self.q)))[:3, 3]


def beside_tool(site: Site, gap: float, **more: Any) -> Limit:
    """A block 2 m long to the left of the attachment, so far off it."""
    low = np.min(corners(site), axis=0)
    high = np.max(corners(site), axis=0)
    return box_limit(
        [0.5 * (low[0] + high[0]), high[1] + gap + 0.5, 0.5 * (low[2] + high[2])], [1.0, 0.5, 1.0], **more
    )


def corners(site: Site) -> Any:
    poses, halves = site.machine.solid_poses(site.machine.forward(site.q))
    signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    return [site.T[:3, :3] @ (poses[-1][:3, :3] @ (s * halves[-1]) + poses[-1][:3, 3]) + site.T[:3, 3] for s in signs]


SWINGS = (Levers(left_x=-1.0), Levers(left_x=1.0))  # to the left, nearer; to the right, away


@pytest.mark.parametrize("gap", [0.15, 0.05, -0.1])
def test_a_limit_switched_on_beside_a_resting_arm_lets_nothing_nearer_and_everything_away(gap: float) -> None:
    site = Site()
    scene, off = Scene(site.machine, [beside_tool(site, gap, state="open")]), frozenset({"open"})
    for _ in range(20):
        site.tick(scene, Levers(), off)
    assert site.slack(scene) < 0.0
    start = site.slack(scene)
    for _ in range(60):
        site.tick(scene, SWINGS[0])
        assert site.towards(scene) <= NO_SPEED_M_S
        assert site.slack(scene) >= start - 1e-4
    assert any(reason.limit == "box" for reason in site.trace.reasons)
    for _ in range(100):
        site.tick(scene, SWINGS[1])
    assert site.slack(scene) > 0.0


@pytest.mark.parametrize("dynamics", [IDEAL, LATE], ids=["ideal", "late"])
def test_a_limit_switched_on_before_a_moving_arm_stops_it_no_later_than_closed_valves(dynamics: Dynamics) -> None:
    worst = []
    for guarded in (True, False):
        site = Site(dynamics)
        scene = Scene(site.machine, [beside_tool(site, 2.2, state="open")])
        for _ in range(75):
            site.tick(scene, SWINGS[0], frozenset({"open"}))
            if site.slack(scene) < 1.2:
                break
        assert 0.0 < site.slack(scene) < 1.2
        least = site.slack(scene)
        for _ in range(150):
            site.tick(scene, SWINGS[0] if guarded else Levers())
            if not guarded:
                site.plant.set_valves((0,) * site.machine.n)
            least = min(least, site.slack(scene))
        worst.append(least)
    assert worst[0] >= min(worst[1], 0.0) - 0.01


@pytest.mark.parametrize("jump", [[0.0, 0.5, 0.0], [0.3, 0.4, 0.0], [0.0, -0.5, 0.0]])
def test_a_jump_of_position_is_answered_in_its_own_tick(jump: Any) -> None:
    site = Site()
    scene = Scene(site.machine, [beside_tool(site, 0.45)])
    for _ in range(20):
        site.tick(scene, SWINGS[0])
    site.T = site.T.copy()
    site.T[:3, 3] += jump
    inside = site.slack(scene) < 0.0
    for _ in range(40):
        before = site.slack(scene)
        site.tick(scene, SWINGS[0])
        if inside:
            assert site.towards(scene) <= NO_SPEED_M_S
        assert site.slack(scene) >= min(before, 0.0) - 1e-4
    assert inside == (jump[1] > 0.0)


def test_a_limit_that_moves_up_to_a_resting_arm_lets_only_what_leads_away() -> None:
    """Its place is told anew every tick, as of another machine; this one stands, then is asked to go towards it."""
    site = Site()
    gap, speed = 1.0, 0.4
    inside = 0
    for k in range(150):
        gap = 1.0 - speed * min(k, 120) * DT_S
        rest = Site()
        rest.q = np.array(site.machine.home)
        velocity = [0.0, -speed if k < 120 else 0.0, 0.0, 0.0, 0.0, 0.0]
        scene = Scene(site.machine, [beside_tool(rest, gap, velocity=velocity)])
        site.tick(scene, SWINGS[0] if k > 40 else Levers())
        if site.slack(scene) < -0.01:
            inside += 1
            assert site.towards(scene) <= NO_SPEED_M_S
    assert inside > 20


def test_an_answer_does_not_hang_on_what_an_earlier_tick_saw() -> None:
    """The same tick asked of scene, guard and memory that saw the limit on, off and elsewhere, and of fresh ones."""
    site = Site()
    limit = beside_tool(site, 0.3, state="open")
    used, fresh_config = Scene(site.machine, [limit]), Site().config
    for k in range(30):
        site.T = np.eye(4)
        site.T[:3, 3] = [0.0, 0.02 * (k % 7), 0.0]
        off = frozenset({"open"}) if k % 5 == 0 else frozenset()
        inputs = site.inputs(used, SWINGS[k % 2], off)
        asked = site.inputs(Scene(site.machine, [limit]), SWINGS[k % 2], off)
        mine, after, here = tick(inputs, site.memory, site.config)
        other, _, there = tick(asked, site.memory, fresh_config)
        assert mine.frame == other.frame
        assert np.array_equal(here.allowed, there.allowed)
        site.memory = after
        site.k += 1
