"""How far vehicles will be from where they are told to be, as far as that shows: on the ground, and where they gather.

On the ground a vehicle does not move, so that what its positions do is its estimator's wander. How far it then wanders
in the air is a matter of its autopilot, see `AutopilotProfile.wander`: as many times what that shows in the air as it
shows on the ground what others of its kind do.

Positions x that wander slowly by w, with noise n of its own in each, differ after half a second by E|dx|^2 = E|dw|^2 +
2 E|n|^2, and from one to the next by nearly 2 E|n|^2 alone: what lies between is the wander, which is what a vehicle
follows. Differences need no mean, which ten seconds would not tell of what changes in four.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Final

import numpy as np
from numpy.typing import NDArray

from fg_gcs.core.arrays import Array
from fg_gcs.flight.fleet import Fleet
from fg_gcs.flight.journal import Journal
from fg_gcs.link.clock import ticks
from fg_gcs.mission.model import Mission
from fg_gcs.plan.wander import Wander
from fg_gcs.wire.autopilots import AutopilotProfile

Indices = NDArray[np.intp]

LOOKS_S: Final = 0.1  # slower than positions come
APART: Final = round(0.5 / LOOKS_S)  # looks that differences of positions are taken over
GROUND_S: Final = 10.0  # of looking at vehicles on the ground
AIR_S: Final = 8.0  # likewise at those that hover
STILL: Final = (round(1.0 / LOOKS_S), 1e-3)  # looks; positions that move less [m] in those do not wander: particles'
NONE_M: Final = 0.005  # less than any separation is told to
SURE: Final = 0.5  # standard deviations of its own that a measured wander is taken wider
DOUBTED: Final = 1.0  # standard deviation of a wander that was measured in the air, over what is known of it
FEWEST: Final = 0.5  # share of the looks in the air that must tell of all vehicles
ALIKE: Final = 2.0  # a vehicle that wanders so many times further than its kind is counted by itself


async def watched(seconds: float, places: Callable[[], Array], moving: Callable[[], None] = lambda: None) -> Array:
    """Return places at instants `LOOKS_S` apart, shape (T, V, 3) [m]; no more than `STILL` has if nothing moves.

    Args:
        seconds: for how long [s].
        places: of vehicles now, shape (V, 3) [m].
        moving: called when it will take so long.
    """
    looks: list[Array] = []
    async for k, _ in ticks(asyncio.get_running_loop().time(), LOOKS_S):
        looks.append(np.array(places()))
        if k == STILL[0]:
            if np.ptp(looks, axis=0).max() < STILL[1]:
                break
            moving()
        if k >= round(seconds / LOOKS_S):
            break
    return np.array(looks)


def kinds(fleet: Fleet) -> list[tuple[AutopilotProfile, Indices]]:
    """Return the autopilots in a fleet, each with the rows of its vehicles."""
    profiles = {vehicle.profile.name: vehicle.profile for vehicle in fleet.vehicles}
    names = np.array([vehicle.profile.name for vehicle in fleet.vehicles])
    return [(profile, np.flatnonzero(names == name)) for name, profile in profiles.items()]


def step_m(positions_m: Array) -> Array:
    """Return by how much each vehicle's wander moves in half a second, rms, as seen from above, shape (V,) [m].

    Args:
        positions_m: at instants `LOOKS_S` apart, shape (T, V, 3) [m].
    """
    if len(positions_m) <= APART + 1:
        return np.zeros(positions_m.shape[1])
    level = positions_m[..., :2]
    slow, quick = level[APART:] - level[:-APART], np.diff(level, axis=0)
    squares: Array = (slow**2).sum(axis=2).mean(axis=0) - (quick**2).sum(axis=2).mean(axis=0)
    return np.sqrt(np.maximum(squares, 0.0))


async def on_the_ground(fleet: Fleet, journal: Journal) -> Array:
    """Return how far vehicles will wander in the air, by how they do on the ground, shape (V, 3) [m; ENU].

    Vehicles of one kind are taken together, but for those that stand out.

    Args:
        fleet: on the ground.
        journal: told if it takes a while.
    """
    text = f"vehicles do not quite stand still by their own estimates: watching how far they wander, for {GROUND_S:g} s"
    positions_m = await watched(GROUND_S, lambda: fleet.states.position_ned_m, lambda: journal.event("wander", text))
    steps_m = step_m(np.nan_to_num(positions_m))
    sigma_m = np.zeros((len(fleet.vehicles), 3))
    for profile, rows in kinds(fleet):
        kind_m = float(np.median(steps_m[rows]))
        usual = rows[steps_m[rows] <= ALIKE * kind_m]
        mean_m = float(np.sqrt((steps_m[usual] ** 2).mean())) if len(usual) else 0.0
        unsure = 1.0 + SURE / np.sqrt(8.0 * GROUND_S * max(len(usual), 1))  # of two axes, twice a second
        expected_m = np.where(steps_m[rows] <= ALIKE * kind_m, mean_m, steps_m[rows]) * unsure
        sigma_m[rows] = expected_m[:, None] / profile.wander.ground_step_m * np.array(profile.wander.hover_enu_m)
    return sigma_m


async def expected_wander(fleet: Fleet, mission: Mission, last_m: Array, journal: Journal) -> Wander | None:
    """Return how far vehicles will wander in the air: as the mission says, or by how they do on the ground.

    What their firmwares did when they last flew counts where that was more; not of vehicles that do not wander now.

    Args:
        fleet: on the ground, its frames known.
        mission: what is flown.
        last_m: how far vehicles of these firmwares hovered off their places, shape (V,) [m]; 0: that is not known.
        journal: told of it, and for the record.

    Returns:
        None: not at all.
    """
    given_m, hold_s = mission.limits.wander_m, mission.hold.duration_s
    if given_m is None:
        sigma_m = await on_the_ground(fleet, journal)
        then_m = np.array([usual(each.profile, m) for each, m in zip(fleet.vehicles, last_m.tolist(), strict=True)])
        found = Wander(np.where(sigma_m > 0.0, np.maximum(sigma_m, then_m), sigma_m), hold_s)
        source = (
            "as they did on their last flight" if (found.sigma_m > sigma_m).any() else "by how they do on the ground"
        )
    else:
        found = Wander(np.array([usual(vehicle.profile, given_m) for vehicle in fleet.vehicles]), hold_s)
        source = "as the mission says"
    journal.recorder.know(wander_m=found.level_m, wander_is_measured=given_m is None)
    if found.level_m < NONE_M:
        return None
    journal.event("wander", f"vehicles are expected to wander by {found.level_m:.2f} m in the air, {source}")
    return found


def usual(profile: AutopilotProfile, level_m: float | None = None) -> Array:
    """Return how far vehicles of an autopilot wander, shape (3,) [m; ENU].

    Args:
        profile: of the autopilot.
        level_m: rms as seen from above [m]; None: as its profile has it.
    """
    hover_m = np.array(profile.wander.hover_enu_m)
    return hover_m if level_m is None else hover_m * (level_m / np.hypot(hover_m[0], hover_m[1]))


async def in_the_air(fleet: Fleet, told_enu_m: Callable[[], Array], expected_m: Array) -> tuple[Array, Array] | None:
    """Return how far vehicles that hover are from where they are told to be, shape (V, 3) [m; ENU].

    Their estimates show a part of it alone. What they do not show is what was expected, less what that shows as a rule;
    squares add up. What is common to all of them brings nobody nearer to anybody.

    Args:
        fleet: its vehicles hover.
        told_enu_m: where they are told to be, shape (V, 3) [m]; NaN: nobody tells them.
        expected_m: how far they were expected to be from there, shape (V, 3) [m; ENU].

    Returns:
        That, and what it is at least, as far as so short a time tells; None: not all were heard and told for long.
    """
    loop = asyncio.get_running_loop()
    errors_m = await watched(AIR_S, lambda: fleet.located(loop.time()).position_enu_m - told_enu_m())
    errors_m = errors_m[np.isfinite(errors_m).all(axis=(1, 2))]
    if len(errors_m) < FEWEST * round(AIR_S / LOOKS_S):
        return None
    apart_m = errors_m - errors_m.mean(axis=1, keepdims=True)
    count = len(fleet.vehicles)
    found_m, least_m = np.empty((count, 3)), np.empty((count, 3))
    for profile, rows in kinds(fleet):
        shown_m = np.sqrt((apart_m[:, rows] ** 2).mean(axis=(0, 1)) * count / max(count - 1, 1))  # (3,)
        unsure = min(1.0, DOUBTED / np.sqrt(AIR_S * len(rows)))  # errors that change in some two seconds, of two axes
        hidden = 1.0 - (profile.wander.shown_m / np.hypot(*profile.wander.hover_enu_m[:2])) ** 2
        squares = hidden * expected_m[rows] ** 2
        found_m[rows], least_m[rows] = np.sqrt(squares + shown_m**2), np.sqrt(squares + ((1.0 - unsure) * shown_m) ** 2)
    return found_m, least_m
