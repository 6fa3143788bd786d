"""What all searches agree on: how they end, how far a step goes, and when a face surrounds its target; compiled."""

from __future__ import annotations

import math

import numpy as np

from fg_gcs.compiling import kernel
from fg_gcs.core.arrays import Array

STEP_M = 1.0  # bound on the leaders' root mean square move in one step near the target: keeps the path smooth
STEP_OF_DISTANCE = 0.1  # the bound grows with the distance: 10 km take tens of steps, not thousands
STEP_GROWTH = 2.0  # from step to step: a spline through steps that grow gently does not swing
TURNED = 0.5  # cosine between normal and target from which on steps grow: before, long ones would go astray
TURN_RAD = 0.3  # largest turn in one step: keeps the attitude's spline true to the iterates
ACCEPT = 0.1  # least share of the predicted gain that a step must bring (any value below 1/4 converges, [More1983]_)
SURROUNDED = 0.75  # flux metric from which the last slide to the axis starts, about 0.25 radii in front of the face
NEAR_RIM = 1e-3  # closer to the rim than this share of its size the flux has no derivative

FOUND, ON_RIM, TOO_MANY, NO_NUMBERS = range(4)


@kernel
def longest_step(distance: float, ahead: float, last: float) -> float:
    """Return the largest move of the leaders in one step, root mean square [m].

    It is long when the face is turned to a far target.

    Args:
        distance: of the target from the face's centre [m].
        ahead: how much of that lies along the face's normal [m].
        last: bound on the step before [m].
    """
    if ahead <= TURNED * distance:
        return STEP_M
    return max(STEP_M, min(STEP_OF_DISTANCE * distance, STEP_GROWTH * last))


@kernel
def surrounds(flux: float) -> bool:
    """Say whether a source sends the face enough flux [sr] for the last slide to start.

    A source that has just passed the face has the flux of the other half sphere, with the other sign.
    """
    unwrapped = flux + 4.0 * math.pi if flux < -math.pi else flux
    return unwrapped > SURROUNDED * 2.0 * math.pi


@kernel
def turn_by(x: float, y: float, z: float) -> Array:
    """Return the rotation by a rotation vector [rad], shape (3, 3), by Rodrigues' formula."""
    angle2 = x * x + y * y + z * z
    if angle2 < 1e-24:  # a turn of a picoradian is none
        return np.eye(3)
    angle = math.sqrt(angle2)
    s, c = math.sin(angle) / angle, (1.0 - math.cos(angle)) / angle2
    turn = np.empty((3, 3))
    turn[0, 0], turn[0, 1], turn[0, 2] = 1.0 - c * (y * y + z * z), c * x * y - s * z, c * x * z + s * y
    turn[1, 0], turn[1, 1], turn[1, 2] = c * x * y + s * z, 1.0 - c * (x * x + z * z), c * y * z - s * x
    turn[2, 0], turn[2, 1], turn[2, 2] = c * x * z - s * y, c * y * z + s * x, 1.0 - c * (x * x + y * y)
    return turn
