from __future__ import annotations

import numpy as np
import pytest

from fg_gcs.core.coverage import coverage, flux_metric, normals
from fg_gcs.core.formation import hemisphere


def test_coverage_is_one_on_the_axis_and_metric_is_one_in_the_face_and_among_the_swarm() -> None:
    formation = hemisphere(4, 5, 5.0)
    rims = np.repeat(formation.leaders_m[None], 5, axis=0)
    sources = np.array([(9.0, 0, 0), (0.0, 0.3, 0), (-0.5, 0, 0), (-9.0, 0, 0), (0.0, 9.0, 0)])
    assert coverage(rims, sources) == pytest.approx([1, 1, 1, 0, 0], abs=1e-6)
    assert flux_metric(rims, sources)[1:] == pytest.approx([1, 1, 0, 0], abs=1e-6)
    assert normals(rims)[0] == pytest.approx([1, 0, 0])


def test_a_folded_rim_covers_nothing() -> None:
    """Two leaders have changed places, nearly: one half of the face looks where the other does not."""
    for lean_m in (0.0, 1e-9, -1e-9):
        rim = np.array([[[0.0, -2.0, -2.0], [0.0, 2.0, 2.0 + lean_m], [0.0, 2.0, -2.0], [0.0, -2.0, 2.0]]])
        rim[0, 0, 0] = 1e-6  # so that it has a normal at all
        assert 0.0 <= coverage(rim, np.array([40.0, 20.0, 24.0]))[0] <= 1.0


def test_coverage_falls_off_like_the_cosine_far_away() -> None:
    rim = hemisphere(6, 0, 1.0).leaders_m[None]
    for angle in (0.2, 0.7, 1.2):
        source = 1e4 * np.array([np.cos(angle), np.sin(angle), 0.0])
        assert coverage(rim, source)[0] == pytest.approx(np.cos(angle), rel=1e-6)
