"""What a swarm can be sent to surround, and how large its face has to be for it.

Flux is additive: several charges send the sum of their fluxes through the face [Hartley2021]_. A target of some
extent, known or not, is reduced to one point with a radius; a face whose inscribed circle has that radius covers it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.stats import chi2

from fg_gcs.core import solid_angle
from fg_gcs.core.arrays import Array
from fg_gcs.core.formation import Formation
from fg_gcs.errors import PlanError

CLEARANCE_M = 10.0  # added to the targets' diameter: 5 m from the outermost one to the leaders' circle
ASYMMETRY = 1e-9  # of the largest entry: more than rounding, and a matrix is no covariance
NEGATIVE = 1e-12  # of the largest eigenvalue: rounding may make a zero one this negative, no more


@dataclass(frozen=True, eq=False)
class Charges:
    """Several sources at once; each one's flux counts by its weight. The arrays are read-only."""

    positions_enu_m: Array  # (C, 3) [m; ENU], C >= 1
    weights: Array  # (C,) each > 0; only their ratios matter

    def __post_init__(self) -> None:
        """Refuse what has no flux.

        Raises:
            PlanError: no charge, a position or weight not finite, a weight not above 0, shapes that do not match.
        """
        positions = _points(self.positions_enu_m)
        weights = _finite(self.weights, (len(positions),), "the charges' weights")
        if not (weights > 0.0).all():
            raise PlanError(f"every charge needs a weight above 0, got {weights.min()}")
        for name, array in (("positions_enu_m", positions), ("weights", weights)):
            array.setflags(write=False)
            object.__setattr__(self, name, array)

    @property
    def centre_enu_m(self) -> Array:
        """The centre of charge: the weighted mean of the positions, shape (3,) [m; ENU]."""
        centre: Array = np.average(self.positions_enu_m, axis=0, weights=self.weights)
        return centre

    def flux(self, vertices_enu_m: Array) -> float:
        """Return the weighted mean of the charges' fluxes through a polygon, shape (N, 3) [m] to [sr].

        A mean, not a sum, so that one charge of any weight has the flux of a unit source and 2 pi stays the most.
        """
        fluxes = [float(solid_angle.flux(vertices_enu_m, position)) for position in self.positions_enu_m]
        return float(np.average(fluxes, weights=self.weights))

    def gradient(self, vertices_enu_m: Array) -> Array:
        """Return the derivative of :meth:`flux` by every vertex; (N, 3) [m] to (N, 3) [sr/m].

        No charge may lie on the rim.
        """
        slopes = [solid_angle.gradient(vertices_enu_m, position) for position in self.positions_enu_m]
        total: Array = np.average(slopes, axis=0, weights=self.weights)
        return total


@dataclass(frozen=True, eq=False)
class Target:
    """What a formation surrounds: one source or more, and the ball around their centre that its face has to cover."""

    sources: Charges
    radius_m: float = 0.0  # of the ball; 0: a point, for which a formation keeps its size [m]

    def __post_init__(self) -> None:
        """Refuse what is no ball.

        Raises:
            PlanError: the radius is negative or not finite.
        """
        if not 0.0 <= self.radius_m < np.inf:
            raise PlanError(f"a target's radius must be a finite number of metres, 0 or more, got {self.radius_m}")

    @classmethod
    def ball(cls, position_enu_m: ArrayLike, radius_m: float = 0.0) -> Target:
        """Return a ball with one source at its centre, shape (3,) [m; ENU].

        Raises:
            PlanError: the position is not three finite numbers, or the radius is negative or not finite.
        """
        position = _finite(position_enu_m, (3,), "a target's position")
        return cls(Charges(position[None], np.ones(1)), radius_m)

    @property
    def centre_enu_m(self) -> Array:
        """The centre of the ball: the sources' centre of charge, shape (3,) [m; ENU]."""
        return self.sources.centre_enu_m

    @property
    def source(self) -> Array | Charges:
        """What the planner is guided by: the point, shape (3,) [m; ENU], or the charges if there are several."""
        positions = self.sources.positions_enu_m
        return positions[0] if len(positions) == 1 else self.sources

    def wider(self, by_m: float) -> Target:
        """Return the same sources in a larger ball: radii add up.

        A ball of radius a whose centre is known to within b lies in a ball of radius a + b, and in no smaller one.
        """
        return Target(self.sources, self.radius_m + by_m)

    def last_scale(self, formation: Formation, first_scale: float = 1.0) -> float:
        """Return the scale at which the circle inscribed in the face has the target's radius.

        A point leaves the formation at its first scale.

        Raises:
            PlanError: the centre of the face lies outside of it, so that no circle fits.
        """
        if self.radius_m == 0.0:
            return first_scale
        inscribed_m = formation.inscribed_radius_m
        if not inscribed_m > 0.0:
            raise PlanError(
                "no circle fits into a face whose centre lies outside of it; a target with a radius needs one"
            )
        return self.radius_m / inscribed_m


def centre_of_charge(positions_enu_m: ArrayLike, weights: ArrayLike | None = None) -> Target:
    """Return the one target that stands for several: their centre of charge with an effective radius.

    The face is a square of edge ``l = (2 d_max + 10 m) / sqrt(2)``, ``d_max`` being the largest distance from the
    centre: its diagonal is the diameter of all targets and 10 m more. The radius is the one of the circle inscribed in
    that square, ``l / 2``. The targets themselves lie inside the square's circumscribed circle.

    Args:
        positions_enu_m: where the targets are, shape (C, 3), C >= 1 [m; ENU].
        weights: how much each counts, above 0, shape (C,); without them all count the same.

    Raises:
        PlanError: no position, one that is not three finite numbers, or a weight that is not above 0.
    """
    positions = _points(positions_enu_m)
    charges = Charges(positions, np.ones(len(positions)) if weights is None else np.asarray(weights, dtype=float))
    return Target.ball(charges.centre_enu_m, effective_radius_m(charges))


def effective_radius_m(charges: Charges) -> float:
    """Return the radius of the circle that a face around several targets has to hold, see :func:`centre_of_charge`."""
    with np.errstate(over="ignore"):  # absurd distances become infinite, and no target has an infinite radius
        furthest_m = np.linalg.norm(charges.positions_enu_m - charges.centre_enu_m, axis=1).max()
    return float(0.5 * (2.0 * furthest_m + CLEARANCE_M) / np.sqrt(2.0))


def uncertain(mean_enu_m: ArrayLike, covariance_m2: ArrayLike, confidence: float) -> Target:
    """Return the ball that holds a normally distributed target with at least the stated confidence.

    The ellipsoid ``(x - mean)^T C^-1 (x - mean) <= q`` holds it with exactly the confidence when ``q`` is the
    quantile of the chi-square distribution with three degrees of freedom. The ball around that ellipsoid has the
    radius ``sqrt(q lambda)`` by the largest eigenvalue of C; it errs on the safe side unless all three are equal.

    Args:
        mean_enu_m: expected position, shape (3,) [m; ENU].
        covariance_m2: symmetric and positive semi-definite, shape (3, 3) [m^2; ENU].
        confidence: probability inside (0, 1).

    Raises:
        PlanError: a number is not finite, the matrix is no covariance, or the confidence is outside (0, 1).
    """
    covariance = _finite(covariance_m2, (3, 3), "a covariance")
    if not 0.0 < confidence < 1.0:
        raise PlanError(f"the confidence must lie between 0 and 1, got {confidence}")
    if np.abs(covariance - covariance.T).max() > ASYMMETRY * np.abs(covariance).max():
        raise PlanError("the covariance must be symmetric")
    values = np.linalg.eigvalsh(covariance)
    if values[0] < -NEGATIVE * np.abs(values).max():
        raise PlanError(f"the covariance must be positive semi-definite, but has the eigenvalue {values[0]:.3g} m^2")
    quantile = float(chi2.ppf(confidence, df=3))
    return Target.ball(mean_enu_m, float(np.sqrt(quantile * max(values[-1], 0.0))))


def _points(values: ArrayLike) -> Array:
    """Return one point or more, shape (C, 3)."""
    try:
        count = len(np.asarray(values, dtype=float))
    except (TypeError, ValueError) as error:
        raise PlanError("targets must be rows of three finite numbers") from error
    if count == 0:
        raise PlanError("there must be at least one target")
    return _finite(values, (count, 3), "targets")


def _finite(values: ArrayLike, shape: tuple[int, ...], what: str) -> Array:
    """Return a copy of the values as an array of that shape, all finite."""
    try:
        array = np.array(values, dtype=float)
    except (TypeError, ValueError) as error:
        raise PlanError(f"{what} must be finite numbers of shape {shape}") from error
    if array.shape != shape or not np.isfinite(array).all():
        raise PlanError(f"{what} must be finite numbers of shape {shape}")
    return array
