"""The nearest setpoint that may leave: a small QP, judged by scipy's."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import LinearConstraint, NonlinearConstraint, minimize

from fg_gcs.core.arrays import Array
from fg_gcs.core.mending import nearest


def drawn(seed: int) -> tuple[Array, Array, Array, Array, float]:
    """A point, planes that leave room, and a ball that reaches into it."""
    random = np.random.default_rng(seed)
    planes = int(random.integers(1, 7))
    normals = random.normal(size=(planes, 3))
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    inside = random.normal(size=3)
    offsets = normals @ inside - random.uniform(0.0, 0.5, planes)
    radius = random.uniform(0.5, 2.0)
    centre = inside + random.uniform(0.0, 0.9) * radius * normals[0]
    return random.normal(scale=2.0, size=3), normals, offsets, centre, radius


@pytest.mark.parametrize("seed", range(40))
def test_the_nearest_point_is_that_of_a_quadratic_program(seed: int) -> None:
    point, normals, offsets, centre, radius = drawn(seed)
    out = np.empty(3)
    assert nearest(point, normals, offsets, centre, radius, out)
    assert (normals @ out >= offsets - 1e-6).all()
    assert np.linalg.norm(out - centre) <= radius + 1e-9

    def square(x: Array, other: Array) -> float:
        return float(((x - other) ** 2).sum())

    ball = NonlinearConstraint(lambda x: [square(x, centre)], -np.inf, radius**2)
    theirs = minimize(
        square,
        centre,
        args=(point,),
        method="SLSQP",
        constraints=[LinearConstraint(normals, offsets), ball],
        options={"ftol": 1e-12, "maxiter": 300},
    )
    assert np.linalg.norm(out - point) <= np.linalg.norm(theirs.x - point) + 1e-4
    np.testing.assert_allclose(out, theirs.x, atol=2e-3)


def test_one_plane_is_a_projection_and_a_point_that_may_leave_stays_as_it_is() -> None:
    out, up = np.empty(3), np.array([[0.0, 0.0, 1.0]])
    assert nearest(np.array([1.0, 2.0, -3.0]), up, np.zeros(1), np.zeros(3), 9.0, out)
    np.testing.assert_allclose(out, (1.0, 2.0, 0.0), atol=1e-12)
    assert nearest(np.array([1.0, 2.0, 3.0]), up, np.zeros(1), np.zeros(3), 9.0, out)
    assert out.tolist() == [1.0, 2.0, 3.0]


def test_where_there_is_no_such_point_it_says_so() -> None:
    both = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]])
    assert not nearest(np.zeros(3), both, np.array([1.0, 1.0]), np.zeros(3), 9.0, np.empty(3))
    assert not nearest(np.zeros(3), both[:1], np.array([1.0]), np.zeros(3), 0.5, np.empty(3))
