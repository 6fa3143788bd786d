from __future__ import annotations

import numpy as np
import pytest

from fg_gcs.core import kernels, solid_angle
from tests.core.test_solid_angle import bent


def test_compiled_flux_and_derivatives_are_those_of_the_reference() -> None:
    for seed in range(60):
        rim, source = bent(seed)
        assert kernels.polygon_flux(rim, source) == pytest.approx(float(solid_angle.flux(rim, source)), abs=1e-12)
        exact = solid_angle.edge_derivatives(rim, source)
        rays = rim - source
        out = np.empty((14, 3))
        for edge in range(len(rim)):
            a, b = rays[edge].tolist(), rays[(edge + 1) % len(rim)].tolist()
            kernels.edge_derivatives(a[0], a[1], a[2], b[0], b[1], b[2], out)
            assert out[:2] == pytest.approx(exact.gradient[edge], abs=1e-14)
            blocks = out[2:].reshape(2, 2, 3, 3)
            assert blocks == pytest.approx(exact.hessian[edge], abs=1e-13)


def test_a_source_in_the_face_counts_the_same_in_both() -> None:
    square = np.array([(0, -1, -1), (0, 1, -1), (0, 1, 1), (0, -1, 1)], dtype=float)
    for place in ((0, 0, 0), (0, 0.3, 0.2), (0, 4, 0)):
        source = np.array(place, dtype=float)
        assert kernels.polygon_flux(square, source) == pytest.approx(float(solid_angle.flux(square, source)), abs=1e-6)
