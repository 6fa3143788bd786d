"""Homes: neighbours are a spacing apart, on Earth as well."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fg_gcs.core.frames import Geodetic, enu_from_geodetic
from fg_gcs.errors import MissionError
from fg_gcs.sitl.layout import Layout, homes, places, read_places


@settings(max_examples=40)
@given(
    layout=st.sampled_from(Layout),
    count=st.integers(1, 40),
    spacing_m=st.floats(1.5, 200.0),
    home=st.builds(Geodetic, st.floats(-70.0, 70.0), st.floats(-170.0, 170.0), st.floats(-100.0, 3000.0)),
)
def test_neighbours_are_a_spacing_apart_and_all_are_level(
    layout: Layout, count: int, spacing_m: float, home: Geodetic
) -> None:
    places_m = places(layout, count, spacing_m)
    assert places_m.shape == (count, 2)
    there = homes(places_m, home)
    assert {each.altitude_m for each in there} == {home.altitude_m}
    back_m = np.array([enu_from_geodetic(each, home)[:2] for each in there])
    assert np.abs(back_m - places_m).max() < 1e-4 * max(1.0, np.abs(places_m).max())
    if count > 1:
        apart_m = np.linalg.norm(places_m[:, None] - places_m, axis=2)[~np.eye(count, dtype=bool)]
        assert apart_m.min() == pytest.approx(spacing_m)


def test_homes_of_a_file(tmp_path: Path) -> None:
    path = tmp_path / "homes.csv"
    path.write_text("# east, north\n0,0\n\n3.5, -2  # the second\n10,10\n")
    assert read_places(path, 2).tolist() == [[0.0, 0.0], [3.5, -2.0]]
    for text, reason in (
        ("0,0\n", "1 homes for 2 vehicles"),
        ("0,0\n1,2,3\n", "line 2: '1,2,3' is not EAST,NORTH in metres"),
        ("0,0\nnan,0\n", "line 2: 'nan,0' is not"),
        ("0,0\n0.5,0\n", "homes 1 and 2 are 0.50 m apart"),
    ):
        path.write_text(text)
        with pytest.raises(MissionError, match=reason):
            homes(read_places(path, 2), Geodetic(47.0, 8.0, 0.0))
    path.write_bytes(b"\xff\xfe")
    with pytest.raises(MissionError, match="not a text"):
        read_places(path, 1)
    with pytest.raises(MissionError, match="No such file"):
        read_places(tmp_path / "none.csv", 1)
