from __future__ import annotations

import numpy as np
import pytest

from fg_gcs.experiment.scenes import RADII_M, REACH_M, SEPARATIONS_M, crowd, draws, printed_rows, scene


def test_the_printed_rows_are_the_papers() -> None:
    rows = printed_rows()
    assert len(rows) == 50
    assert np.mean([row.flux_metric for row in rows]) == pytest.approx(0.986, abs=5e-4)
    assert min(row.flux_metric for row in rows) == 0.86
    first = rows[0].scene
    assert (first.target_enu_m.tolist(), first.edge_m, first.last_edge_m) == ([72.0, -53.0, 17.0], 11.0, 16.0)


def test_the_square_starts_where_the_paper_puts_it() -> None:
    made = scene((50.0, 50.0, 50.0))
    assert made.leaders_enu_m == pytest.approx(np.array([(0, 0, 0), (0, 5, 0), (0, 5, 5), (0, 0, 5)]), abs=1e-12)
    assert len(made.formation.slots_m) == 9


def test_draws_are_seeded_and_keep_their_ranges() -> None:
    one, same, other = draws(200, 1), draws(200, 1), draws(200, 2)
    for a, b in zip(one, same, strict=True):
        assert np.array_equal(a.target_enu_m, b.target_enu_m)
        assert (a.edge_m, a.last_edge_m) == (b.edge_m, b.last_edge_m)
    assert not np.array_equal(one[0].target_enu_m, other[0].target_enu_m)
    for made in one:
        assert np.abs(made.target_enu_m).max() <= REACH_M
        assert SEPARATIONS_M[0] <= made.edge_m <= SEPARATIONS_M[1]
        assert 2.0 * RADII_M[0] <= made.last_edge_m <= 2.0 * RADII_M[1]


def test_the_face_around_a_crowd_holds_every_target_with_its_margin() -> None:
    for seed in range(20):
        made, targets = crowd(seed)
        assert made.target_enu_m == pytest.approx(targets.mean(axis=0))
        to_corner_m = made.last_edge_m / np.sqrt(2.0)
        largest_m = np.linalg.norm(targets - made.target_enu_m, axis=1).max()
        assert to_corner_m == pytest.approx(largest_m + 5.0)
