"""A session's joints: what moves them, the drive that fits their valves, and what is said of both."""

import math
from dataclasses import dataclass

import numpy as np

from workgauge.drive.api import Drive
from workgauge.drive.hydraulic import HydraulicDrive
from workgauge.drive.ideal import IdealDrive
from workgauge.machine.model import MachineModel
from workgauge.machine.stopping import StoppingModel
from workgauge.rehearse.hydraulic_choice import HydraulicChoice, hydraulic_spec
from workgauge.rehearse.hydraulic_choice import Joints as JointsChoice
from workgauge.sim.hydraulics import HydraulicSpec
from workgauge.sim.joints import Joints, joints_of
from workgauge.values.arrays import Floats


@dataclass(frozen=True, slots=True, eq=False)
class Moving:
    """What moves a session's joints.

    Attributes:
        joints: simulated, at rest. drive: what the tick sends their valves.
        late: whether they are to be expected to follow late, so that automatic motion commands ahead.
        words: for people. assumption: what a run takes for granted of them.
    """

    joints: Joints
    drive: Drive
    late: bool
    words: str
    assumption: str


def moving(choice: JointsChoice, machine: MachineModel) -> Moving:
    """Return what moves the joints of a machine, as a scenario's `joints` says.

    Raises:
        ScenarioError: for joints, units or a pump the machine does not have.
    """
    spec = hydraulic_spec(choice, machine)
    if spec is None:
        return Moving(
            joints_of(machine, None),
            IdealDrive.of(machine),
            False,
            "ideal",
            "Joints are ideal: each follows its valve at once, without dead time, lag or flow limit.",
        )
    own = isinstance(choice, HydraulicChoice) and bool(choice.model_fields_set - {"vary_seed", "vary_percent"})
    words = f"hydraulic, {'with numbers of its own' if own else 'as the machine file says'}"
    if isinstance(choice, HydraulicChoice) and choice.vary_seed is not None:
        words += f", drawn within tolerance by seed {choice.vary_seed}"
    return Moving(joints_of(machine, spec), _drive(choice, machine), True, words, _assumption(spec, words))


def _drive(choice: JointsChoice, machine: MachineModel) -> HydraulicDrive:
    """Return the drive for the joints as they are said to be, not as they were drawn.

    Of a dead band known within a tolerance it makes up for the least, so that no joint goes faster than asked.
    """
    share: Floats | float = 0.0
    if isinstance(choice, HydraulicChoice) and choice.vary_seed is not None:
        share = StoppingModel.of(machine).tolerance if choice.vary_percent is None else choice.vary_percent / 100.0
        choice = choice.model_copy(update={"vary_seed": None, "vary_percent": None})
    spec = hydraulic_spec(choice, machine)
    assert spec is not None, "hydraulic joints stay hydraulic without a draw"
    band = spec.dead_band * (1.0 - share)
    resting = {} if band.any() else {"rest": 0.0, "keep": 0.0}
    pump = spec.pump
    return HydraulicDrive(
        full_speed=_pairs(spec.full_speed),
        dead_band=_pairs(band),
        flow=() if pump is None else _pairs(np.stack([pump.flow_positive, pump.flow_negative])),
        pump=math.inf if pump is None else pump.flow,
        cylinders=spec.cylinders,
        **resting,
    )


def _pairs(rows: Floats) -> tuple[tuple[float, float], ...]:
    """Return (2, n) as (positive, negative) of each joint."""
    return tuple((float(up), float(down)) for up, down in rows.T)


def _assumption(spec: HydraulicSpec, words: str) -> str:
    parts = [
        f"dead time {_range(spec.dead_time_s)} s",
        f"lag {_range(spec.lag_s)} s",
        f"dead band {_range(100.0 * spec.dead_band)} %",
        "one pump for all" if spec.pump is not None else "flow enough for all",
    ]
    if spec.script:
        parts.append(f"{len(spec.script)} change{'s' if len(spec.script) > 1 else ''} on the way")
    return f"Joints are {words}: {', '.join(parts)}; the simulated machine has exactly these, a real one will differ."


def _range(values: Floats) -> str:
    low, high = float(values.min()), float(values.max())
    return f"{low:.3g}" if f"{low:.3g}" == f"{high:.3g}" else f"{low:.3g} to {high:.3g}"
