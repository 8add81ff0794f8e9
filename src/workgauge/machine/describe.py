"""A machine in a few lines for people: joints in degrees, boxes, what is kept apart."""

import math
from typing import Any

from workgauge.machine.model import MachineModel


def describe(machine: MachineModel) -> dict[str, Any]:
    """Return a JSON-ready summary; angles in degrees, lengths in metres, `None` for an end that is not there."""
    return {
        "name": machine.name,
        "title": machine.title,
        "undercarriage": machine.undercarriage.kind,
        "attachment": machine.attachment,
        "attachments": list(machine.attachments),
        "joints": [_joint(machine, i) for i in range(machine.n)],
        "links": list(machine.link_names),
        "boxes": [{"name": solid.name, "link": machine.link_names[solid.link]} for solid in machine.solids],
        "kept_apart": [[machine.solids[i].name, machine.solids[j].name] for i, j in machine.self_pairs],
        "not_checked": [{"boxes": [pair.first, pair.second], "why": pair.why} for pair in machine.skipped_pairs],
        "sensors": [{"name": sensor.name, "link": machine.link_names[sensor.link]} for sensor in machine.sensors],
        "exclusive_groups": [[machine.joint_names[j] for j in group] for group in machine.exclusive_groups],
    }


def _joint(machine: MachineModel, i: int) -> dict[str, Any]:
    sliding = bool(machine.prismatic[i])
    unit = "m" if sliding else "deg"

    def shown(value: float) -> float | None:
        if math.isinf(value):
            return None
        return round(float(value) if sliding else math.degrees(value), 6)

    return {
        "name": machine.joint_names[i],
        "moves": machine.link_names[i + 1],
        "type": "prismatic" if sliding else "revolute",
        f"lower_{unit}": shown(machine.q_min[i]),
        f"upper_{unit}": shown(machine.q_max[i]),
        f"home_{unit}": shown(machine.home[i]),
        f"speed_positive_{unit}_s": shown(machine.speed_positive[i]),
        f"speed_negative_{unit}_s": shown(machine.speed_negative[i]),
        "lever": machine.levers[i],
        "lever_sign": int(machine.lever_signs[i]),
    }
