"""Places on the Earth: against published coordinates, and there and back."""

from __future__ import annotations

import numpy as np
import pytest

from rtgs.maths.wgs84 import enu_from_places, places_from_enu


@pytest.mark.parametrize("origin", [(0.0, 0.0, 0.0), (52.0, 13.4, 40.0), (-89.999, 10.0, 2800.0), (10.0, 179.9999, 0.0)])
def test_there_and_back_is_exact(origin: tuple[float, float, float]) -> None:
    enu = np.random.default_rng(0).uniform(-5000, 5000, (200, 3))
    places = places_from_enu(enu, origin)
    np.testing.assert_allclose(enu_from_places(places, origin), enu, atol=1e-6)


def test_a_degree_has_its_known_length() -> None:
    """A degree of latitude is 110.574 km at the equator and 111.694 km at a pole; a degree of longitude is 111.320 km at the equator."""
    small = 1e-4
    north = enu_from_places((small, 0.0, 0.0), (0.0, 0.0, 0.0))
    east = enu_from_places((0.0, small, 0.0), (0.0, 0.0, 0.0))
    polar = enu_from_places((90 - small, 0.0, 0.0), (90.0, 0.0, 0.0))
    assert north[1] / small == pytest.approx(110_574, abs=1)
    assert east[0] / small == pytest.approx(111_320, abs=1)
    assert np.hypot(*polar[:2]) / small == pytest.approx(111_694, abs=1)


def test_up_is_the_height_and_nothing_else() -> None:
    np.testing.assert_allclose(enu_from_places((47.1, 11.2, 612.5), (47.1, 11.2, 600.0)), [0, 0, 12.5], atol=1e-8)
