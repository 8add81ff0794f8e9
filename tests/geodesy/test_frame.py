"""The site's local frame."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from workgauge.geodesy.frame import SiteFrame

coordinate = st.floats(-1e5, 1e5)


@given(st.tuples(coordinate, coordinate, coordinate))
def test_local_and_back(place):
    frame = SiteFrame(None, np.array([21_530_000.0, 6_783_000.0, 0.0]))
    local = np.array([place, place])
    assert frame.to_absolute(local)[0] == pytest.approx(local[0] + [21_530_000.0, 6_783_000.0, 0.0])
    assert frame.to_local(frame.to_absolute(local)) == pytest.approx(local, abs=1e-8)


def test_the_origin_is_read_only_and_has_three_numbers():
    frame = SiteFrame(None, np.zeros(3))
    with pytest.raises(ValueError, match="read-only"):
        frame.origin[0] = 1.0
    with pytest.raises(ValueError, match="shape"):
        SiteFrame(None, np.zeros(2))
