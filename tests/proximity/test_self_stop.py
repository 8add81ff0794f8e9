"""Clearances between links carry the machine's own stop distance, those to limits the limit's."""

import functools
import math
from dataclasses import replace

import numpy as np

from workgauge.machine.load import load_machine
from workgauge.proximity.scene import Scene
from workgauge.values import transforms as tf
from workgauge.values.arrays import frozen
from workgauge.values.limits import Limit, LimitKind, Source
from workgauge.values.solids import Box


@functools.cache
def machine():
    return load_machine("brokk5")


def pole(x: float, stop: float | None) -> Limit:
    solid = Box(frozen(tf.translation(x, 0.0, 1.0)), frozen([0.1, 0.1, 1.0]))
    return Limit(f"pole-{x}", LimitKind.POINT, "Pole", solid, "poles", Source("t", "p"), stop_distance_m=stop)


def test_own_links_stop_where_the_machine_says_and_limits_where_they_do() -> None:
    limits = [pole(3.5, None), pole(4.5, 0.4)]
    for stop in (None, 0.05, 0.6):
        scene = Scene(replace(machine(), self_stop_distance_m=stop), limits)
        found = scene.query(machine().forward(machine().home), np.eye(4), 5.0)
        own = found.other_links >= 0
        assert own.any() and (found.limits[~own] == 0).any() and (found.limits[~own] == 1).any()
        stops = found.stop_distances
        assert np.isnan(stops[own]).all() if stop is None else (stops[own] == stop).all()
        assert np.isnan(stops[found.limits == 0]).all() and (stops[found.limits == 1] == 0.4).all()
        assert scene.largest_stop_m == max(stop or 0.0, 0.4)
    assert Scene(machine(), []).largest_stop_m == 0.05
    assert Scene(replace(machine(), self_stop_distance_m=None), []).largest_stop_m == 0.0
    assert not math.isnan(Scene(machine(), limits).largest_stop_m)
