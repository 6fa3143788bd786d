from __future__ import annotations

from typing import cast

import numpy as np
import pytest

from fg_gcs.core import solid_angle
from fg_gcs.core.arrays import Array


def polygon(count: int, radius: float = 3.0) -> Array:
    angles = 2 * np.pi * np.arange(count) / count
    return np.stack((np.zeros(count), radius * np.cos(angles), radius * np.sin(angles)), axis=1)


def bent(seed: int) -> tuple[Array, Array]:
    """A random rim, not quite flat, and a source somewhere in front of it or behind."""
    draw = np.random.default_rng(seed)
    rim = polygon(3 + seed % 6) + draw.normal(size=(3 + seed % 6, 3)) * 0.3
    return rim, draw.normal(size=3) * 6.0 + np.sign(draw.normal()) * np.array([2.0, 0.0, 0.0])


def on_axis_of_square(half: float, distance: float) -> float:
    """Textbook solid angle of a square seen from its axis."""
    return float(4 * np.arcsin(half**2 / (half**2 + distance**2)))


@pytest.mark.parametrize("distance", [0.01, 0.5, 3.0, 40.0, 1e4])
def test_a_square_on_its_axis_has_the_textbook_value(distance: float) -> None:
    square = np.array([(0, -1, -1), (0, 1, -1), (0, 1, 1), (0, -1, 1)]) * 2.5
    flux = solid_angle.flux(square, np.array([distance, 0.0, 0.0]))
    assert flux == pytest.approx(on_axis_of_square(2.5, distance), rel=1e-6)


def test_the_faces_of_a_cube_share_the_sphere() -> None:
    corners = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=float)
    faces = []
    for axis in range(3):
        for side in (-1, 1):
            face = corners[corners[:, axis] == side]
            middle = face.mean(axis=0)
            arms = face - middle
            around = np.arctan2(arms @ np.roll(middle, 2), arms @ np.roll(middle, 1))
            faces.append(face[np.argsort(around)])
    source = np.array([0.3, -0.2, 0.6])
    total = sum(abs(float(solid_angle.flux(face, source))) for face in faces)
    assert total == pytest.approx(4 * np.pi, rel=1e-12)


def test_turning_the_winding_round_changes_the_sign() -> None:
    for seed in range(20):
        rim, source = bent(seed)
        assert solid_angle.flux(rim[::-1], source) == pytest.approx(-solid_angle.flux(rim, source), abs=1e-12)


def test_flux_is_positive_in_front_of_the_face_and_negative_behind_it() -> None:
    square = polygon(4)
    assert solid_angle.flux(square, np.array([5.0, 1.0, 0.0])) > 0
    assert solid_angle.flux(square, np.array([-5.0, 1.0, 0.0])) < 0


@pytest.mark.parametrize("count", [3, 4, 5, 12])
def test_a_source_in_the_face_has_half_the_sphere_and_one_beside_it_nothing(count: int) -> None:
    rim = polygon(count)
    for inside in ((0.0, 0.0, 0.0), (0.0, 0.4, -0.7)):
        assert solid_angle.flux(rim, np.array(inside)) == pytest.approx(2 * np.pi, abs=1e-6)
    assert solid_angle.flux(rim, np.array([0.0, 9.0, 1.0])) == pytest.approx(0.0, abs=1e-6)


def test_flux_goes_on_growing_through_the_face() -> None:
    depths = np.linspace(-1.0, 0.5, 151)
    flux = solid_angle.unwrapped(solid_angle.flux(polygon(4), np.stack((-depths, 0 * depths, 0 * depths), 1)[:, None]))
    assert (np.diff(flux) > 0).all()
    assert flux[100] == pytest.approx(2 * np.pi, abs=1e-6)


def test_the_gradient_is_the_finite_difference() -> None:
    step = 1e-6
    for seed in range(40):
        rim, source = bent(seed)
        exact = solid_angle.gradient(rim, source)
        moves = np.eye(rim.size).reshape(-1, *rim.shape) * step
        difference = (solid_angle.flux(rim + moves, source) - solid_angle.flux(rim - moves, source)) / (2 * step)
        assert np.abs(exact.ravel() - difference).max() < 1e-6 * np.abs(exact).max()


def test_the_hessian_is_the_finite_difference_of_the_gradient_and_symmetric() -> None:
    step = 1e-6
    for seed in range(40):
        rim, source = bent(seed)
        exact = solid_angle.hessian(rim, source).reshape(rim.size, rim.size)
        moves = np.eye(rim.size).reshape(-1, *rim.shape) * step
        difference = np.array(
            [(solid_angle.gradient(rim + m, source) - solid_angle.gradient(rim - m, source)).ravel() for m in moves]
        ) / (2 * step)
        assert np.abs(exact - difference).max() < 1e-6 * np.abs(exact).max()
        assert np.abs(exact - exact.T).max() < 1e-12 * np.abs(exact).max()


def wide(values: Array) -> Array:
    """The same in numbers with 64 bits of mantissa: differences of nearly singular functions need them."""
    return cast(Array, values.astype(np.longdouble))


def nearly_singular(seed: int) -> tuple[Array, Array]:
    """A flat needle, or a source close to an edge, to a vertex, or outside next to the edge's extension."""
    draw = np.random.default_rng(seed)
    rim = polygon(3 + seed % 6)
    rim[:, 1] *= draw.choice([1.0, 1e-2])  # a needle
    start, end = rim[0], rim[1]
    along = draw.choice([draw.uniform(0.1, 0.9), 0.0, 1.0, -0.2, 1.3])
    gap_m = 10.0 ** draw.uniform(-4, -1)
    away = draw.normal(size=3)
    return rim, start + along * (end - start) + gap_m * away / np.linalg.norm(away)


@pytest.mark.parametrize("seed", range(60))
def test_derivatives_hold_close_to_singular_shapes(seed: int) -> None:
    own_rim, own_source = nearly_singular(seed)
    rim, source = wide(own_rim), wide(own_source)
    gap = min(float(np.linalg.norm(source - vertex)) for vertex in rim)
    edges = np.roll(rim, -1, axis=0) - rim
    shares = np.clip(np.einsum("ek,ek->e", source - rim, edges) / np.einsum("ek,ek->e", edges, edges), 0.0, 1.0)
    gap = min(gap, float(np.linalg.norm(rim + shares[:, None] * edges - source, axis=1).min()))
    step = 1e-5 * gap  # the error of the difference is its square, 1e-10
    moves = wide(np.eye(rim.size)).reshape(-1, *rim.shape) * step
    slope = (solid_angle.flux(rim + moves, source) - solid_angle.flux(rim - moves, source)) / (2 * step)
    exact = solid_angle.gradient(own_rim, own_source)
    assert np.abs(exact.ravel() - slope).max() < 1e-6 * np.abs(exact).max()
    bends = [(solid_angle.gradient(rim + m, source) - solid_angle.gradient(rim - m, source)).ravel() for m in moves]
    curved = solid_angle.hessian(own_rim, own_source)
    assert np.abs(curved.reshape(rim.size, -1) - np.array(bends) / (2 * step)).max() < 1e-6 * np.abs(curved).max()


@pytest.mark.parametrize("size_m", [0.1, 1.0, 30.0])
def test_a_source_on_the_extension_of_an_edge_has_derivatives_too(size_m: float) -> None:
    rim = size_m * np.array([(0.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 1.0, 1.0), (0.0, 0.0, 1.0)])
    source, step = size_m * np.array([0.0, 2.5, 0.0]), 1e-6 * size_m
    moves = np.eye(rim.size).reshape(-1, *rim.shape) * step
    difference = (solid_angle.flux(rim + moves, source) - solid_angle.flux(rim - moves, source)) / (2 * step)
    exact = solid_angle.gradient(rim, source)
    assert np.abs(exact.ravel() - difference).max() < 1e-6 * np.abs(exact).max()
    bent_by = [(solid_angle.gradient(rim + m, source) - solid_angle.gradient(rim - m, source)).ravel() for m in moves]
    hessian = solid_angle.hessian(rim, source).reshape(rim.size, -1)
    assert np.abs(hessian - np.array(bent_by) / (2 * step)).max() < 1e-6 * np.abs(hessian).max()


def test_moving_rim_and_source_together_changes_nothing() -> None:
    for seed in range(20):
        rim, source = bent(seed)
        assert np.abs(solid_angle.gradient(rim, source).sum(axis=0) - _by_source(rim, source)).max() < 1e-6


def _by_source(rim: Array, source: Array) -> Array:
    step = 1e-6
    return np.array(
        [
            -(solid_angle.flux(rim, source + e) - solid_angle.flux(rim, source - e)) / (2 * step)
            for e in np.eye(3) * step
        ]
    )
