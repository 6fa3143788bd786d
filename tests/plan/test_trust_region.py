from __future__ import annotations

import numpy as np
import pytest

from fg_gcs.core.arrays import Array
from fg_gcs.plan.search.trust_region import maximise_in_ball


def gain(gradient: Array, hessian: Array, point: Array) -> float:
    return float(gradient @ point + 0.5 * point @ hessian @ point)


def test_maximise_in_ball_beats_every_random_point_and_stays_inside() -> None:
    for seed in range(100):
        draw = np.random.default_rng(seed)
        matrix = draw.normal(size=(6, 6))
        hessian = matrix + matrix.T
        gradient = draw.normal(size=6) * draw.choice([0.0, 1e-3, 1.0, 1e3])
        if seed % 3 == 0:  # no gradient along the leading eigenvector: the hard case
            leading = np.linalg.eigh(hessian)[1][:, -1]
            gradient -= (gradient @ leading) * leading
        best = maximise_in_ball(gradient, hessian)
        assert np.linalg.norm(best) <= 1.0 + 1e-6
        points = draw.normal(size=(3000, 6))
        points /= np.maximum(np.linalg.norm(points, axis=1), 1.0)[:, None]
        values = points @ gradient + 0.5 * np.einsum("ni,ij,nj->n", points, hessian, points)
        value = best @ gradient + 0.5 * best @ hessian @ best
        assert value >= values.max() - 1e-6 * (1 + abs(value))


@pytest.mark.parametrize("count", [1, 2, 6, 11])
def test_the_multiplier_proves_it_the_maximum(count: int) -> None:
    for seed in range(50):
        draw = np.random.default_rng(seed)
        matrix = draw.normal(size=(count, count))
        hessian = (matrix + matrix.T) * 10.0 ** draw.uniform(-8, 8)
        gradient = draw.normal(size=count) * 10.0 ** draw.uniform(-8, 8)
        best = maximise_in_ball(gradient, hessian)
        size = np.linalg.norm(gradient) + np.abs(hessian).sum()
        multiplier = float(best @ (gradient + hessian @ best)) / max(float(best @ best), 1e-300)
        assert multiplier >= max(0.0, float(np.linalg.eigvalsh(hessian)[-1])) - 1e-6 * size
        assert np.abs(gradient + hessian @ best - multiplier * best).max() <= 1e-6 * size


def test_inside_the_ball_it_is_newtons_step() -> None:
    hessian = np.diag([-2.0, -3.0, -4.0])
    gradient = np.array([0.2, -0.3, 0.4])
    assert maximise_in_ball(gradient, hessian) == pytest.approx(np.array([0.1, -0.1, 0.1]))


def test_without_any_gradient_it_climbs_along_the_leading_eigenvector_to_the_positive_side() -> None:
    best = maximise_in_ball(np.zeros(3), np.diag([1.0, 5.0, -2.0]))
    assert best == pytest.approx(np.array([0.0, 1.0, 0.0]), abs=1e-9)
    assert maximise_in_ball(np.zeros(3), -np.eye(3)) == pytest.approx(np.zeros(3))
    assert maximise_in_ball(np.zeros(3), np.zeros((3, 3))) == pytest.approx(np.zeros(3))
    one, other = (maximise_in_ball(np.zeros(4), np.eye(4)) for _ in range(2))
    assert np.array_equal(one, other)
    assert np.linalg.norm(one) == pytest.approx(1.0)
