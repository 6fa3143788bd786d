"""WGS84: round trips, and lengths that are known from elsewhere."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from sitl_mock.physics.geodesy import Geodetic, World

metres = st.floats(-20_000.0, 20_000.0)


@given(st.floats(-89.9, 89.9), st.floats(-180.0, 180.0), st.floats(-400.0, 9000.0), metres, metres, metres)
def test_ned_and_back(
    latitude_deg: float, longitude_deg: float, altitude_m: float, north_m: float, east_m: float, down_m: float
) -> None:
    world = World(Geodetic(latitude_deg, longitude_deg, altitude_m))
    assert world.ned_m(world.geodetic(north_m, east_m, down_m)) == pytest.approx((north_m, east_m, down_m), abs=1e-6)


def test_origin_is_where_it_is() -> None:
    point = World(Geodetic(47.397742, 8.545594, 488.0)).geodetic(0.0, 0.0, 0.0)
    assert (point.latitude_deg, point.longitude_deg) == pytest.approx((47.397742, 8.545594), abs=1e-12)
    assert point.altitude_m == pytest.approx(488.0, abs=1e-6)


def test_one_degree_at_the_equator() -> None:
    """The equator is a circle of 6378137 m; a meridian degree there is 110574 m."""
    world = World(Geodetic(0.0, 0.0, 0.0))
    _, east_m, down_m = world.ned_m(Geodetic(0.0, 1.0, 0.0))
    assert east_m == pytest.approx(6378137.0 * math.sin(math.radians(1.0)), abs=1e-3)
    assert down_m == pytest.approx(6378137.0 * (1.0 - math.cos(math.radians(1.0))), abs=1e-3)
    north_m, _, _ = world.ned_m(Geodetic(0.01, 0.0, 0.0))
    assert north_m * 100.0 == pytest.approx(110574.0, abs=1.0)


def test_up_is_altitude() -> None:
    point = World(Geodetic(47.0, 8.0, 500.0)).geodetic(0.0, 0.0, -40.0)
    assert point.altitude_m == pytest.approx(540.0, abs=1e-6)
