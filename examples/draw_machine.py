"""Draw a machine as the program sees it: boxes, joint axes and tool in side view, plan and from the front.

Run: python examples/draw_machine.py rre20 docs/machines/rre20.svg
"""

import sys
from pathlib import Path

import matplotlib as mpl
import numpy as np
from scipy.spatial import ConvexHull

from workgauge.machine.load import load_machine
from workgauge.machine.model import Kinematics, MachineModel
from workgauge.values.arrays import Floats
from workgauge.values.solids import Box

mpl.use("Agg")
mpl.rcParams["svg.hashsalt"] = "workgauge"
mpl.rcParams["svg.fonttype"] = "none"
from matplotlib import pyplot as plt  # noqa: E402
from matplotlib.axes import Axes  # noqa: E402

COLOURS = ("#4d4d4d", "#1b6ca8", "#c1440e", "#2e8b57", "#8e44ad", "#b8860b", "#00798c", "#9c2c77")
PLANES = {"x": 0, "y": 1, "z": 2}


def colour(machine: MachineModel, link: int) -> str:
    """Return the colour of a link."""
    return COLOURS[link % len(COLOURS)]


def draw_boxes(axes: Axes, machine: MachineModel, kin: Kinematics, plane: tuple[int, int], names: bool) -> None:
    """Fill every link solid's outline."""
    poses, halves = machine.solid_poses(kin)
    for solid, pose, half in zip(machine.solids, poses, halves, strict=True):
        seen = Box(pose, half).vertices[:, plane]
        outline = seen[ConvexHull(seen).vertices]
        axes.fill(*outline.T, facecolor=colour(machine, solid.link), alpha=0.16, zorder=1)
        axes.fill(*outline.T, fill=False, edgecolor=colour(machine, solid.link), linewidth=1.0, zorder=2)
        if names:
            low = seen[:, 1].min() * 0.85 + seen[:, 1].max() * 0.15
            axes.annotate(solid.name, (seen[:, 0].mean(), low), ha="center", va="center", fontsize=7, zorder=3)


def draw_axes(
    axes: Axes, machine: MachineModel, kin: Kinematics, plane: tuple[int, int], joints: range, length: float
) -> None:
    """Draw the axes of some joints: an arrow where they lie in the picture, a ring where they stand on it."""
    T_parents = [kin.T_machine_links[i] @ joint.T_parent_joint for i, joint in enumerate(machine.chain)]
    for i in joints:
        place = T_parents[i][:3, 3]
        axis = T_parents[i][:3, :3] @ machine.chain[i].axis
        seen, flat = place[list(plane)], axis[list(plane)]
        name, tint = machine.joint_names[i], colour(machine, i + 1)
        if np.linalg.norm(flat) < 0.3:
            axes.plot(*seen, "o", markersize=9, markerfacecolor="white", markeredgecolor=tint, zorder=6)
            axes.plot(*seen, ".", markersize=3, color=tint, zorder=7)
            end = seen
        else:
            start, end = seen - 0.4 * length * flat, seen + length * flat
            axes.annotate("", end, start, arrowprops={"arrowstyle": "-|>", "color": tint, "linewidth": 1.6}, zorder=6)
        axes.annotate(name, end, (6, 5), textcoords="offset points", fontsize=8, color=tint, weight="bold", zorder=8)


def draw_skeleton(axes: Axes, machine: MachineModel, kin: Kinematics, plane: tuple[int, int]) -> None:
    """Join the link frames' origins and the tool centre point."""
    points: Floats = np.array([*kin.T_machine_links[1:, :3, 3], machine.tool_pose(kin)[:3, 3]])[:, plane]
    axes.plot(*points.T, color="black", linewidth=1.2, zorder=4)
    axes.plot(*points[-1], "x", color="black", markersize=8, zorder=5)


def view(axes: Axes, title: str, across: str, up: str) -> tuple[int, int]:
    """Set a picture's title and axes and return its plane."""
    axes.set_title(title, fontsize=9)
    axes.set_aspect("equal")
    axes.set_xlabel(f"{across} [m]", fontsize=8)
    axes.set_ylabel(f"{up} [m]", fontsize=8)
    axes.tick_params(labelsize=7)
    axes.grid(alpha=0.3)
    return PLANES[across], PLANES[up]


def draw(machine: MachineModel) -> plt.Figure:
    """Return the figure: side view, plan, and the last joints from the side and from the front."""
    figure, ((side, plan), (near, front)) = plt.subplots(
        2, 2, height_ratios=(5, 6), figsize=(11, 8), layout="constrained"
    )
    home = machine.forward(machine.home)
    tool = machine.tool_pose(home)[:3, 3]
    reach, last = float(np.hypot(*tool[:2])), machine.n - 1

    plane = view(side, f"{machine.title}: home posture from the right", "x", "z")
    draw_boxes(side, machine, home, plane, names=True)
    draw_skeleton(side, machine, home, plane)
    draw_axes(side, machine, home, plane, range(min(3, machine.n)), 0.13 * reach)
    side.axhline(0.0, color="black", linewidth=1.0)

    plane = view(plan, "plan", "x", "y")
    draw_boxes(plan, machine, home, plane, names=False)
    draw_skeleton(plan, machine, home, plane)
    poses, halves = machine.solid_poses(home)
    swept = [
        np.linalg.norm(Box(pose, half).vertices[:, :2], axis=1).max()
        for solid, pose, half in zip(machine.solids, poses, halves, strict=True)
        if solid.link == 1
    ]
    for radius in swept:
        plan.add_patch(plt.Circle((0, 0), radius, fill=False, linestyle="--", linewidth=0.8))
    radii = ", ".join(f"{radius:.2f} m" for radius in sorted(swept, reverse=True))
    plan.set_title(f"plan; dashed: swept by what turns with the cabin, radius {radii}", fontsize=9)

    around = 1.2 * np.linalg.norm(tool - home.T_machine_links[-2][:3, 3]) + 0.3
    middle = 0.5 * (tool + home.T_machine_links[-2][:3, 3])
    plane = view(near, "last joints from the right, home", "x", "z")
    draw_boxes(near, machine, home, plane, names=False)
    draw_skeleton(near, machine, home, plane)
    draw_axes(near, machine, home, plane, range(min(2, last), machine.n), 0.45)
    near.set(xlim=(middle[0] - around, middle[0] + around), ylim=(middle[2] - around, middle[2] + around))

    turned = np.array(machine.home)
    title = "last joints seen from the tool's far side"
    if "tilt" in machine.joint_names:
        turned[machine.joint_names.index("tilt")] = np.radians(30.0)
        title += ", tilt 30°"
    kin = machine.forward(turned)
    plane = view(front, title, "y", "z")
    draw_boxes(front, machine, kin, plane, names=False)
    draw_skeleton(front, machine, kin, plane)
    draw_axes(front, machine, kin, plane, range(min(3, last), machine.n), 0.45)
    front.set(xlim=(-around, around), ylim=(middle[2] - around, middle[2] + around))
    return figure


if __name__ == "__main__":
    target = Path(sys.argv[2])
    target.parent.mkdir(parents=True, exist_ok=True)
    draw(load_machine(sys.argv[1])).savefig(target, metadata={"Date": None} if target.suffix == ".svg" else None)
