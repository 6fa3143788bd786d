from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fg_gcs.core.frames import (
    EquidistantGlobe,
    EquirectangularGlobe,
    Geodetic,
    Globe,
    LocalFrames,
    Seen,
    enu_from_geodetic,
    geodetic_from_enu,
    rotate_ned_enu,
    swap_ned_enu,
    turned_towards,
    yaw_from_enu,
)

metres = st.floats(-1e5, 1e5)
vectors = st.tuples(metres, metres, metres)
nearby = st.floats(-700.0, 700.0)
spread = st.tuples(st.floats(-70.0, 70.0), st.floats(-70.0, 70.0), st.floats(-10.0, 50.0))
places = st.builds(Geodetic, st.floats(-80, 80), st.floats(-180, 180), st.floats(-100, 5000))


GLOBES: list[Globe] = [EquirectangularGlobe(6_378_100.0), EquidistantGlobe(6_371_000.0)]


@given(st.sampled_from(GLOBES), st.floats(-70.0, 70.0), st.tuples(nearby, nearby), st.tuples(nearby, nearby), spread)
def test_frames_are_those_of_their_globes_where_vehicles_fly_together(
    globe: Globe,
    latitude_deg: float,
    start: tuple[float, float],
    around: tuple[float, float],
    by: tuple[float, float, float],
) -> None:
    """A vehicle that starts up to a kilometre away is right to a centimetre, 100 m around where frames are joined."""
    origin = Geodetic(latitude_deg, 179.999, 488.0)
    own, around_enu_m = geodetic_from_enu(np.array([*start, 0.0]), origin), np.array([*around, 10.0])
    frames = LocalFrames.joined([Seen(globe, own, 0.25)], origin, around_enu_m)
    place = around_enu_m + by
    north, east = globe.local_m(geodetic_from_enu(place, origin), own)
    found = frames.one_enu_m(0, (north, east, 0.25 - place[2]))
    assert found == pytest.approx(place, abs=0.01)
    assert frames.enu_m(np.array([[east, north, place[2] - 0.25]]))[0] == pytest.approx(found, abs=1e-9)
    flat = place[:2] - frames.origins_enu_m[0, :2]
    assert frames.inverse[0] @ flat == pytest.approx([east, north], abs=0.01)


@pytest.mark.parametrize(
    ("globe", "north_percent", "east_percent"), [(GLOBES[0], 0.12, -0.19), (GLOBES[1], 0.01, -0.30)]
)
def test_frames_on_spheres_are_as_long_as_measured(globe: Globe, north_percent: float, east_percent: float) -> None:
    """Latitude 47, two digits: ArduPilot and PX4, see docs/autopilots."""
    origin = Geodetic(47.397742, 8.545594, 488.0)
    north, _ = globe.local_m(geodetic_from_enu(np.array([0.0, 100.0, 0.0]), origin), origin)
    _, east = globe.local_m(geodetic_from_enu(np.array([100.0, 0.0, 0.0]), origin), origin)
    assert north - 100.0 == pytest.approx(north_percent, abs=0.0075)
    assert east - 100.0 == pytest.approx(east_percent, abs=0.0075)


@given(vectors, vectors)
def test_frames_that_are_moved_and_parallel_ones(
    origin: tuple[float, float, float], by: tuple[float, float, float]
) -> None:
    frames = LocalFrames.parallel(np.array([origin, origin])).moved(1, np.array(by))
    assert frames.one_enu_m(0, (1.0, 2.0, 3.0)) == pytest.approx(np.add(origin, (2.0, 1.0, -3.0)))
    assert frames.one_enu_m(1, (1.0, 2.0, 3.0)) == pytest.approx(np.add(np.add(origin, by), (2.0, 1.0, -3.0)))


@given(vectors)
def test_scalar_and_array_rotations_agree_and_undo_themselves(vector: tuple[float, float, float]) -> None:
    assert tuple(swap_ned_enu(np.array(vector)).tolist()) == rotate_ned_enu(vector)
    assert rotate_ned_enu(rotate_ned_enu(vector)) == vector


def test_north_east_down_by_name() -> None:
    east_north_up = LocalFrames.parallel(np.array([[100.0, 200.0, 5.0]])).one_enu_m(0, (1.0, 2.0, 3.0))
    assert east_north_up == (102.0, 201.0, 2.0)


@given(places, st.tuples(st.floats(-2e4, 2e4), st.floats(-2e4, 2e4), st.floats(-500, 5000)))
def test_geodesy_there_and_back(origin: Geodetic, point: tuple[float, float, float]) -> None:
    place = geodetic_from_enu(np.array(point), origin)
    assert enu_from_geodetic(place, origin) == pytest.approx(np.array(point), abs=1e-6)


def test_a_degree_of_latitude_is_as_long_as_the_tables_say() -> None:
    at_45 = enu_from_geodetic(Geodetic(45.5, 9.0, 0.0), Geodetic(44.5, 9.0, 0.0))
    assert np.hypot(at_45[1], at_45[2]) == pytest.approx(111_132.0, abs=5.0)  # NIMA TR8350.2: 111,132 m at 45 degrees


@pytest.mark.parametrize(
    ("direction", "heading"), [((0, 1, 0), 0.0), ((1, 0, 0), np.pi / 2), ((0, -1, 0), np.pi), ((-1, 0, 5), -np.pi / 2)]
)
def test_yaw_counts_clockwise_from_north(direction: tuple[float, float, float], heading: float) -> None:
    east, north, _ = map(float, direction)
    assert yaw_from_enu(east, north) == pytest.approx(heading)


@given(
    st.lists(st.tuples(st.floats(-9.0, 9.0), st.floats(-9.0, 9.0)), min_size=1, max_size=9),
    st.floats(0.0, 4.0),
)
def test_headings_turn_the_short_way_and_no_further_than_allowed(pairs: list[tuple[float, float]], most: float) -> None:
    before, wanted = np.array(pairs).T.copy()
    turned = turned_towards(before, wanted, most)
    across = np.angle(np.exp(1j * (wanted - before)))
    assert np.exp(1j * turned) == pytest.approx(np.exp(1j * (before + np.clip(across, -most, most))), abs=1e-9)
    assert ((turned >= -np.pi) & (turned <= np.pi)).all()


def test_a_wanted_heading_that_is_no_number_leads_to_none() -> None:
    turned = turned_towards(np.zeros(2), np.array([np.nan, 1.0]), 0.5)
    assert np.isnan(turned[0])
    assert turned[1] == pytest.approx(0.5)
