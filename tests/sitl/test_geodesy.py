"""WGS84: round trips, and lengths that are known from elsewhere."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sitl_mock.physics.geodesy import Geodetic, World

metres = st.floats(-20_000.0, 20_000.0)
Place = tuple[float, float, float]


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


@given(st.floats(-90.0, 90.0), st.floats(-180.0, 180.0), st.lists(st.tuples(metres, metres, metres), max_size=5))
def test_rows_are_the_points_one_by_one(latitude_deg: float, longitude_deg: float, ned_m: list[Place]) -> None:
    world = World(Geodetic(latitude_deg, longitude_deg, 400.0))
    rows = world.geodetic_rows(np.array(ned_m).reshape(-1, 3))
    for row, place in zip(rows.tolist(), ned_m, strict=True):
        point = world.geodetic(*place)
        assert row[:2] == pytest.approx((point.latitude_deg, point.longitude_deg), abs=1e-11)
        assert row[2] == pytest.approx(point.altitude_m, abs=1e-6)


@pytest.mark.parametrize(
    ("radius_m", "north_percent", "east_percent"), [(6378100.0, 0.12, -0.19), (6371000.0, 0.01, -0.30)]
)
def test_frames_on_spheres_are_as_long_as_measured(radius_m: float, north_percent: float, east_percent: float) -> None:
    """Latitude 47, two digits: ArduPilot and PX4."""
    (north, _), (_, east) = World(Geodetic(47.397742, 8.545594, 488.0)).local_axes(radius_m, 0.0, 0.0, 0.0).tolist()
    assert 100.0 * (north - 1.0) == pytest.approx(north_percent, abs=0.0075)
    assert 100.0 * (east - 1.0) == pytest.approx(east_percent, abs=0.0075)


@pytest.mark.parametrize(
    ("radius_m", "offsets_m", "tolerance_m"),
    [
        (6378100.0, (0.20, 0.39, 0.56, 0.75, 0.97, 1.16, 1.32, 1.51), 0.05),
        (6371000.0, (0.24, 0.59, 0.94, 1.33), 0.15),  # PX4 itself wanders by more than 0.1 m
    ],
)
def test_offsets_in_hold_are_those_measured(radius_m: float, offsets_m: tuple[float, ...], tolerance_m: float) -> None:
    """Vehicles 100, 200, 300 ... m to the east hold so far from where they were told."""
    east = World(Geodetic(47.397742, 8.545594, 488.0)).local_axes(radius_m, 0.0, 0.0, 0.0)[1, 1]
    for k, offset_m in enumerate(offsets_m, start=1):
        assert 100.0 * k * (1.0 / east - 1.0) == pytest.approx(offset_m, abs=tolerance_m)


@given(st.floats(-80.0, 80.0), st.floats(0.0, 3000.0), st.floats(-2e3, 2e3), st.floats(-2e3, 2e3))
def test_a_frame_s_axes_are_the_derivative_of_its_coordinates(
    latitude_deg: float, altitude_m: float, north_m: float, east_m: float
) -> None:
    world, radius_m, step_m = World(Geodetic(latitude_deg, 8.0, altitude_m)), 6371000.0, 1.0
    here = world.geodetic(north_m, east_m, 0.0)

    def local(by_north_m: float, by_east_m: float) -> np.ndarray:
        there = world.geodetic(north_m + by_north_m, east_m + by_east_m, 0.0)
        north = math.radians(there.latitude_deg - here.latitude_deg)
        east = math.radians(there.longitude_deg - here.longitude_deg) * math.cos(math.radians(here.latitude_deg))
        return radius_m * np.array([north, east])

    derivative = np.stack([local(step_m, 0.0) - local(-step_m, 0.0), local(0.0, step_m) - local(0.0, -step_m)], axis=1)
    axes = world.local_axes(radius_m, north_m, east_m, 0.0)
    np.testing.assert_allclose(axes, derivative / (2.0 * step_m), atol=1e-6)
