"""Cant tables evaluated."""

import numpy as np
import pytest

from workgauge.site.cant import CantPoint, CantTable
from workgauge.site.transitions import Law


def test_cant_runs_straight_through_a_reversal():
    table = CantTable([CantPoint(0.0, 0.1), CantPoint(50.0, 0.0), CantPoint(100.0, -0.1)], 1.435, None)
    assert table.at(np.array([-5.0, 0.0, 25.0, 50.0, 75.0, 100.0, 130.0])) == pytest.approx(
        [0.1, 0.1, 0.05, 0.0, -0.05, -0.1, -0.1]
    )


@pytest.mark.parametrize(
    ("law", "quarter"),
    [
        (Law.CLOTHOID, 0.25),
        (Law.CUBIC_PARABOLA, 0.25),
        (Law.BIQUADRATIC, 0.125),
        (Law.BLOSS, 3 / 16 - 2 / 64),
        (Law.COSINE, (1 - np.cos(np.pi / 4)) / 2),
        (Law.SINE, 0.25 - 1 / (2 * np.pi)),
    ],
)
def test_ramps_follow_their_law(law, quarter):
    table = CantTable([CantPoint(10.0, 0.02, law), CantPoint(50.0, 0.12)], 1.524, "insideRail")
    assert table.at(np.array([20.0, 30.0, 40.0])) == pytest.approx([0.02 + 0.1 * quarter, 0.07, 0.12 - 0.1 * quarter])


def test_two_places_at_one_distance_are_a_step():
    table = CantTable(
        [CantPoint(0.0, 0.0), CantPoint(10.0, 0.0), CantPoint(10.0, 0.05), CantPoint(20.0, 0.05)], None, None
    )
    assert table.at(np.array([9.999, 10.0, 15.0])) == pytest.approx([0.0, 0.05, 0.05])


def test_one_place_holds_everywhere():
    assert CantTable([CantPoint(5.0, 0.03)], None, None).at(np.array([0.0, 5.0, 9.0])) == pytest.approx(0.03)
