"""A few ticks nobody sees, so that no tick that counts has to wait for compiled code."""

from dataclasses import replace

import numpy as np

from workgauge.guard import programme
from workgauge.loop.config import SOURCE, TickConfig
from workgauge.loop.inputs import TickInputs
from workgauge.loop.memory import first_memory
from workgauge.loop.tick import tick
from workgauge.proximity.scene import Scene
from workgauge.values.arrays import Floats, frozen, frozen_ints
from workgauge.values.limits import Limit, LimitKind, Source
from workgauge.values.measurements import DriveMode, Intent, Levers, MachinePose, Posture, Stamp
from workgauge.values.solids import Box, Solid, Surface, Tube
from workgauge.values.transforms import translation

#: Ticks of each run: the switch let go, pressed, then levers out.
_TICKS = 4
#: Where things are, from the tool [m]: in it, at its stop distance, and within the guard's sight.
_APART_M = (0.0, 0.4, 1.5)


def warm_up(config: TickConfig) -> None:
    """Run a few ticks of the machine in a place of their own: sure and unsure of where it is, near and in limits.

    What is compiled depends on what kinds of things there are, not on where or how many: after this, no tick of this
    configuration compiles anything. Half a minute the first time on a computer, half a second the first time in a
    process, less after. Nothing is kept but the compiled code.
    """
    machine = config.machine
    tool = machine.tool_pose(machine.forward(machine.home))[:3, 3]
    programme.warm_up()
    things = _things(tool, _APART_M)
    for limits in (things, _things(tool, _APART_M[-1:]), things[: len(_APART_M)]):
        scene = Scene(machine, limits)
        for sigma in (0.0, 1e-3):
            _run(config, scene, sigma)


def _things(tool: Floats, apart: tuple[float, ...]) -> list[Limit]:
    """Return a box at each distance from the tool (3,), a line, ground, and a box that moves and is unsure."""
    x, y, z = tool.tolist()
    boxes = [Box(frozen(translation(x + by, y, z)), frozen([0.2, 0.2, 0.2])) for by in apart]
    line = Tube(frozen([[x, y - 5.0, z + 4.0], [x, y + 5.0, z + 4.0]]), 0.1)
    corners = [[x - 9.0, y - 9.0, z - 3.0], [x + 9.0, y - 9.0, z - 3.0], [x, y + 9.0, z - 3.0]]
    ground = Surface(frozen(corners), frozen_ints([[0, 1, 2]]))
    solids: list[Solid] = [*boxes, line, ground]
    limits = [
        Limit(f"{i}", LimitKind.ZONE, f"{i}", solid, SOURCE, Source(SOURCE, f"{i}")) for i, solid in enumerate(solids)
    ]
    velocity, covariance = frozen([0.1, 0.0, 0.0, 0.0, 0.0, 0.0]), frozen(np.eye(6) * 1e-6)
    return [*limits, replace(limits[len(boxes) - 1], id="moving", velocity=velocity, covariance=covariance)]


def _run(config: TickConfig, scene: Scene, sigma: float) -> None:
    """Run the ticks of one scene."""
    machine, memory, period_ns = config.machine, first_memory(config), round(config.dt_s * 1e9)
    covariance, joint_sigma = frozen(np.eye(6) * sigma**2), frozen(np.full(machine.n, sigma))
    for k in range(_TICKS):
        now = (k + 1) * period_ns
        stamp = Stamp(config.machine_id, now, SOURCE)
        levers = Levers(left_x=0.8, left_y=0.5, right_y=-0.5) if k > 1 else Levers()
        inputs = TickInputs(
            now,
            Posture(stamp, machine.home, joint_sigma),
            MachinePose(stamp, frozen(np.eye(4)), covariance),
            Intent(stamp, DriveMode.JOINT, levers, k > 0),
            scene,
        )
        memory = tick(inputs, memory, config)[1]
