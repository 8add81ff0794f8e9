"""Whether a machine's `positioning` section fits the machine: names, kinds and places of sensors, sane thresholds."""

import itertools
import math
from collections.abc import Iterable

from workgauge.machine.faults import DescriptionError, Place
from workgauge.machine.model import MachineModel
from workgauge.machine.parts import Sensor
from workgauge.machine.positioning import JointSensorSpec, PositioningSpec

_TOP: Place = ("positioning",)
_TILTING = ("imu", "inclinometer")
_KINDS = {"encoder": ("encoder",), "inclination": _TILTING, "wire_encoder": ("wire_encoder",)}
#: Two antennas nearer than this give no useful heading [m].
SHORTEST_BASELINE_M = 0.3
#: A joint whose axis stands within this of upright, whatever the others do, cannot be told by gravity [degree].
UPRIGHT_DEG = 10.0


def check_positioning(machine: MachineModel) -> None:
    """Check the section against the machine it belongs to.

    Raises:
        DescriptionError: at the first value that does not fit, with what would.
    """
    spec = machine.positioning
    if spec is None:
        return
    sensors = {sensor.name: sensor for sensor in machine.sensors}
    _receivers(spec, sensors)
    _heading(machine, spec, sensors)
    _named(sensors, (*_TOP, "tilt", "sensor"), spec.tilt.sensor, _TILTING)
    _joints(machine, spec, sensors)
    _thresholds(spec)


def _named(sensors: dict[str, Sensor], place: Place, name: str, kinds: Iterable[str]) -> Sensor:
    """Return the sensor of that name, of one of the kinds."""
    wanted = tuple(kinds)
    fitting = ", ".join(known for known, sensor in sensors.items() if sensor.kind in wanted) or "none in `sensors`"
    if name not in sensors:
        raise DescriptionError(place, "no such sensor", name, fitting)
    if sensors[name].kind not in wanted:
        message = f"is a sensor of kind {sensors[name].kind}, not {' or '.join(wanted)}"
        raise DescriptionError(place, message, name, fitting)
    return sensors[name]


def _receivers(spec: PositioningSpec, sensors: dict[str, Sensor]) -> None:
    for i, receiver in enumerate(spec.receivers):
        place: Place = (*_TOP, "receivers", i)
        _named(sensors, (*place, "antenna"), receiver.antenna, ("gnss_antenna",))
        for other in spec.receivers[:i]:
            if receiver.name == other.name:
                raise DescriptionError((*place, "name"), "name used twice", receiver.name, "unique names")
            if receiver.antenna == other.antenna:
                raise DescriptionError(
                    (*place, "antenna"), "antenna of another receiver already", receiver.antenna, "one each"
                )
            if receiver.port == other.port and (
                receiver.talker is None or other.talker is None or receiver.talker == other.talker
            ):
                raise DescriptionError(
                    (*place, "port"),
                    f"receivers {other.name} and {receiver.name} cannot be told apart on one port",
                    receiver.port,
                    "a port each, or a `talker` each",
                )
        kinds = ("fixed_m", "float_m", "differential_m", "single_m")
        for better, worse in itertools.pairwise(kinds):
            pairs = zip(getattr(receiver.sigmas, better), getattr(receiver.sigmas, worse), strict=True)
            if any(b > w for b, w in pairs):
                raise DescriptionError(
                    (*place, "sigmas", worse), f"surer than {better}", list(getattr(receiver.sigmas, worse)),
                    f"at least {list(getattr(receiver.sigmas, better))}",
                )  # fmt: skip


def _heading(machine: MachineModel, spec: PositioningSpec, sensors: dict[str, Sensor]) -> None:
    place: Place = (*_TOP, "heading")
    heading = spec.heading
    ends = [_named(sensors, (*place, key), getattr(heading, key), ("gnss_antenna",)) for key in ("master", "rover")]
    if heading.master == heading.rover:
        raise DescriptionError((*place, "rover"), "a baseline has two antennas", heading.rover, "another antenna")
    apart = ends[1].T_link_sensor[:3, 3] - ends[0].T_link_sensor[:3, 3]
    length = math.sqrt(float(apart @ apart))
    if ends[0].link == ends[1].link and length < SHORTEST_BASELINE_M:
        raise DescriptionError(
            (*place, "rover"),
            f"antennas {length:.3f} m apart give no heading",
            heading.rover,
            f"{SHORTEST_BASELINE_M:g} m or more",
        )
    links = machine.forward(machine.home).T_machine_links
    places = [(links[end.link] @ end.T_link_sensor)[:3, 3] for end in ends]
    level = math.hypot(*(places[1] - places[0])[:2].tolist())
    if level < SHORTEST_BASELINE_M:
        raise DescriptionError(
            (*place, "rover"),
            f"antennas that lie {level:.3f} m apart seen from above, at the home posture, give no heading",
            heading.rover,
            f"{SHORTEST_BASELINE_M:g} m or more; mind the link's own axes",
        )
    if heading.kind == "two_antennas":
        served = [receiver.antenna for receiver in spec.receivers]
        for key in ("master", "rover"):
            if getattr(heading, key) not in served:
                raise DescriptionError(
                    (*place, key), "antenna without a receiver", getattr(heading, key), ", ".join(served)
                )


def _joints(machine: MachineModel, spec: PositioningSpec, sensors: dict[str, Sensor]) -> None:
    seen: set[str] = set()
    used: set[str] = set()
    for i, one in enumerate(spec.joints):
        place: Place = (*_TOP, "joints", i)
        if one.joint not in machine.joint_names:
            raise DescriptionError((*place, "joint"), "no such joint", one.joint, ", ".join(machine.joint_names))
        if one.joint in seen:
            raise DescriptionError((*place, "joint"), "joint measured twice", one.joint, "one entry per joint")
        seen.add(one.joint)
        sensor = _named(sensors, (*place, "sensor"), one.sensor, _KINDS[one.kind])
        if one.sensor in used:
            raise DescriptionError((*place, "sensor"), "sensor of another joint already", one.sensor, "one each")
        used.add(one.sensor)
        _units(machine, one, place)
        if one.kind == "inclination":
            _inclination(machine, spec, one, sensor, sensors, place)
        elif one.before is not None:
            raise DescriptionError((*place, "before"), "belongs to `kind: inclination`", one.before)
    for name in machine.joint_names:
        if name not in seen:
            raise DescriptionError((*_TOP, "joints"), f"nothing measures joint {name}", allowed="one entry per joint")


def _units(machine: MachineModel, one: JointSensorSpec, place: Place) -> None:
    """Check that angles go with turning joints and lengths with sliding ones."""
    slides = bool(machine.prismatic[machine.joint_names.index(one.joint)])
    kind = "slides" if slides else "turns"
    wire = one.kind == "wire_encoder"
    wrong = {
        "sigma_deg": slides and one.sigma_deg is not None,
        "sigma_m": not slides and not wire and one.sigma_m is not None,
        "offset_deg": slides and one.offset_deg != 0.0,
    }
    for key, bad in wrong.items():
        if bad:
            raise DescriptionError((*place, key), f"joint {one.joint} {kind}", getattr(one, key))
    if one.calibration is not None and (one.calibration.position_deg is None) != slides:
        key = "position_deg" if slides else "position_m"
        other = "position_m" if slides else "position_deg"
        raise DescriptionError((*place, "calibration", key), f"joint {one.joint} {kind}", allowed=f"`{other}`")


def _inclination(
    machine: MachineModel,
    spec: PositioningSpec,
    one: JointSensorSpec,
    sensor: Sensor,
    sensors: dict[str, Sensor],
    place: Place,
) -> None:
    joint = machine.joint_names.index(one.joint)
    names = machine.link_names
    if machine.prismatic[joint]:
        raise DescriptionError((*place, "kind"), "gravity says nothing of a joint that slides", one.kind)
    if one.sign != 1:
        raise DescriptionError((*place, "sign"), "an inclinometer's sense is in its `rpy_deg`", one.sign, "1")
    if sensor.link != joint + 1:
        raise DescriptionError(
            (*place, "sensor"), f"sits on {names[sensor.link]}", one.sensor, f"a sensor on {names[joint + 1]}"
        )
    key, name = ("before", one.before) if one.before is not None else ("joint", spec.tilt.sensor)
    before = _named(sensors, (*place, key), name, _TILTING)
    if before.link > joint:
        raise DescriptionError(
            (*place, key),
            f"{name} sits on {names[before.link]}, not before joint {one.joint}",
            name,
            f"an inclinometer on {', '.join(names[: joint + 1])}",
        )
    postures = [machine.home + turn for turn in (0.0, 0.5, 1.2)]  # axes only: limits do not matter
    upright = math.cos(math.radians(UPRIGHT_DEG))
    if all(abs(float(machine.forward(q).spatial_jacobian[5, joint])) > upright for q in postures):
        raise DescriptionError(
            (*place, "kind"),
            f"joint {one.joint} turns about the vertical, and gravity says nothing of it",
            one.kind,
            "encoder",
        )


def _thresholds(spec: PositioningSpec) -> None:
    limits = spec.thresholds
    place: Place = (*_TOP, "thresholds")
    checks = (
        (
            "dead_reckoning_s",
            limits.dead_reckoning_s >= limits.fix_age_s,
            f"fix_age_s ({limits.fix_age_s:g}) or more",
        ),
        (
            "chassis_frozen_s",
            limits.chassis_frozen_s == 0.0 or limits.chassis_frozen_s >= limits.dead_reckoning_s,
            f"0 for not at all, or dead_reckoning_s ({limits.dead_reckoning_s:g}) or more",
        ),
        ("heading_deg", limits.heading_deg < 90.0, "below 90"),
        ("fix_age_s", limits.fix_age_s <= 10.0, "10 or less"),
        ("link_age_s", limits.link_age_s <= 1.0, "1 or less"),
        ("standing_m_s", limits.standing_m_s <= 1.0, "1 or less"),
    )
    for key, good, allowed in checks:
        if not good:
            raise DescriptionError((*place, key), "does not make sense", getattr(limits, key), allowed)
