"""What a tick was set up with comes back from a log's header, every setting of it."""

import functools
import json
import math
from dataclasses import replace
from typing import Any

import pytest

from workgauge.drive.hydraulic import HydraulicDrive
from workgauge.guard.linear import LinearGuard
from workgauge.loop.config import TickConfig, tick_config
from workgauge.machine.load import load_machine
from workgauge.motion.desired import MotionConfig
from workgauge.motion.joystick import LeverFeel
from workgauge.proximity.protection import Integrity
from workgauge.record.plain import from_plain, json_schema, to_plain
from workgauge.record.setup import configuration, configured
from workgauge.values.errors import InputError


@functools.cache
def machine(name: str = "rre20"):  # type: ignore[no-untyped-def]
    return load_machine(name)


def configs() -> list[TickConfig]:
    hydraulic = HydraulicDrive.of(machine(), 0.07)
    return [
        tick_config(machine(), LinearGuard(), machine_id="m1"),
        tick_config(
            machine(),
            LinearGuard(slow_distance_m=1.1, stop_distance_m=0.31),
            machine_id="m2",
            dt_s=0.01,
            radius_m=9.5,
            posture_age_s=0.3,
            motion=MotionConfig(feel=LeverFeel(pattern="sae", ramp_s=0.4), tool_speed_m_s=1 / 3),
            integrity=Integrity(4.1, 0.02),
            tool_sigma_m=0.013,
            drive=hydraulic,
        ),
        tick_config(machine(), LinearGuard(), machine_id="m3", drive=replace(hydraulic, pump=math.inf, flow=())),
        tick_config(machine("brokk5"), LinearGuard(), machine_id="b", drive=HydraulicDrive.of(machine("brokk5"))),
    ]


@pytest.mark.parametrize("which", range(4))
def test_every_setting_comes_back(which: int) -> None:
    config = configs()[which]
    written = json.loads(json.dumps(configuration(config), allow_nan=False))
    again = configured(written, config.machine)
    for name in TickConfig.__slots__:
        assert getattr(again, name) == getattr(config, name), name
    assert configuration(again) == configuration(config)


def test_another_machine_or_attachment_is_refused() -> None:
    written = configuration(configs()[0])
    with pytest.raises(InputError, match=r"not the machine of the log.*rre20"):
        configured(written, machine("brokk5"))
    with pytest.raises(InputError, match="not the machine of the log"):
        configured(written | {"attachment": "another"}, machine())


@pytest.mark.parametrize(
    "change",
    [
        {"tick": None},
        {"tick": {}},
        {"drive": {"kind": "magic", "settings": None}},
        {"drive": {"kind": "hydraulic", "settings": {"full_speed": 3}}},
        {"drive": 4},
        {"guard": "nobody"},
        {"guard_parameters": {"what": 1.0}},
        {"guard_parameters": {"stop_distance_m": "wide"}},
    ],
)
def test_a_header_that_is_none_is_refused(change: dict[str, Any]) -> None:
    with pytest.raises(InputError):
        configured(configuration(configs()[0]) | change, machine())


def test_one_of_several_words_is_held_to_them() -> None:
    plain = to_plain(LeverFeel())
    assert from_plain(LeverFeel, plain) == LeverFeel()
    with pytest.raises(ValueError, match=r"LeverFeel.pattern: one of .*iso.* expected, found 'xyz'"):
        from_plain(LeverFeel, {**plain, "pattern": "xyz"})
    assert json_schema(LeverFeel)["properties"]["pattern"] == {"enum": ["iso", "sae"]}
