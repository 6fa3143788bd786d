from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fg_gcs.core.arrays import Array
from fg_gcs.track.follow.formation_frames import AXES, Frames, frames_of, state_of


def polynomials(seed: int, scale: float) -> Callable[[Array], Array]:
    """Axes that move along random polynomials of time, with their derivatives; (T,) to (T, 3, 7)."""
    powers = np.random.default_rng(seed).normal(size=(6, AXES)) * 0.3
    powers[0, 6] += scale

    def at(time_s: Array) -> Array:
        orders = [powers]
        for _ in range(2):
            orders.append(np.arange(1, len(orders[-1]))[:, None] * orders[-1][1:])
        return np.stack([np.polynomial.polynomial.polyval(time_s, each).T for each in orders], axis=1)

    return at


def motion(time_s: Array) -> Frames:
    return frames_of(polynomials(1, 3.0)(time_s), ATTITUDE)


ATTITUDE = Rotation.random(rng=np.random.default_rng(3)).as_matrix()
SLOTS = np.random.default_rng(5).normal(size=(6, 3))


def test_velocities_and_accelerations_are_finite_differences() -> None:
    step = 1e-4
    for time in np.linspace(-0.8, 0.8, 9):
        before, here, after = (motion(np.array([time + d])).swarm(SLOTS) for d in (-step, 0.0, step))
        assert (after[0] - before[0]) / (2 * step) == pytest.approx(here[1], abs=1e-5)
        assert (after[1] - before[1]) / (2 * step) == pytest.approx(here[2], abs=1e-4)


def test_a_state_is_the_whole_frame() -> None:
    for time in np.linspace(-0.5, 0.5, 5):
        frames = motion(np.array([time]))
        state = state_of(frames)
        again = frames_of(state.axes[None], state.attitude)
        for one, other in zip(again.swarm(SLOTS), frames.swarm(SLOTS), strict=True):
            assert one == pytest.approx(other, abs=1e-9)
        assert frames.scale[0] == pytest.approx(state.axes[0, 6])


def test_distances_are_those_of_the_template_times_the_scale() -> None:
    frames = motion(np.linspace(-0.5, 0.5, 7))
    gaps = np.linalg.norm(SLOTS[:, None] - SLOTS[None], axis=2)
    for places, scale in zip(frames.swarm(SLOTS)[0], frames.scale, strict=True):
        assert np.linalg.norm(places[:, None] - places[None], axis=2) == pytest.approx(scale * gaps)
