"""Contradictions between keys of a mission, each of which is valid on its own."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from fg_gcs.core.separation import Fence
from fg_gcs.errors import PlanError
from fg_gcs.mission.model import Mission, TargetTable
from fg_gcs.mission.tables import Point, Problem
from fg_gcs.mission.target_validation import target_problems_of
from fg_gcs.plan.rules import outside, too_close


def problems_of(mission: Mission) -> Iterator[Problem]:
    """Yield what is wrong between keys that are each valid on their own."""
    yield from _network_problems(mission)
    fence = mission.fence.box()
    if not (np.array(fence.low_enu_m) < np.array(fence.high_enu_m)).all():
        yield Problem("fence", "high_enu_m", "the fence has no inside; accepted: each number above that of low_enu_m")
        return  # a fence without an inside makes everything else wrong, too
    found = [*_formation_problems(mission), *_aim_problems(mission)]
    yield from found or _size_problems(mission)
    floor = fence.low_enu_m[2]
    if mission.takeoff.height_m < floor:
        text = f"{mission.takeoff.height_m:g} m is below the floor; accepted: {floor:g} m or more ([fence] low_enu_m)"
        yield Problem("takeoff", "height_m", text)
    separation = mission.limits.separation_m
    if mission.pads.spacing_m <= separation:
        text = f"got {mission.pads.spacing_m:g} m; accepted: more than {separation:g} m ([limits] separation_m)"
        yield Problem("pads", "spacing_m", text)


def _network_problems(mission: Mission) -> Iterator[Problem]:
    """Yield what is wrong between networks and the vehicles that are said to be in them."""
    members, vehicles = mission.swarm.members(), mission.swarm.vehicles
    twice = sorted({member for member in members if members.count(member) > 1})
    if twice:
        text = "/".join(str(part) for part in twice[0] if part)
        yield Problem("swarm", "system_ids", f"{text} occurs twice; accepted: a different id for every vehicle")
    if len(members) != vehicles:
        yield Problem("swarm", "system_ids", f"{len(members)} ids for {vehicles} vehicles; accepted: {vehicles} ids")
    networks = mission.networks or {}
    for name, endpoints in networks.items():
        wrong = [endpoint for endpoint in endpoints if not 0 < int(endpoint.rpartition(":")[2]) < 65536]
        if wrong:
            yield Problem("networks", name, f"{wrong[0]}; accepted: a port from 1 to 65535")
        if not endpoints:
            yield Problem("networks", name, "has no endpoint; accepted: one or more, as in udpin:127.0.0.1:14550")
    if mission.networks is not None and not networks:
        yield Problem("networks", "", "is empty; accepted: one or more networks")
    for network, system_id in members if mission.swarm.system_ids else ():
        if network and network not in networks:
            known = f"one of {', '.join(networks)}" if networks else "ids alone, or a table [networks]"
            yield Problem("swarm", "system_ids", f'no network is called "{network}"; accepted: {known}')
        elif not network and len(networks) > 1:
            accepted = " or ".join(f'"{name}/{system_id}"' for name in networks)
            yield Problem("swarm", "system_ids", f"{system_id} names no network; accepted: {accepted}")


def _formation_problems(mission: Mission) -> Iterator[Problem]:
    table = mission.formation
    try:
        formation = table.formation()
    except ValueError as error:
        yield Problem("formation", "shape", str(error))
        return
    slots, vehicles = len(formation.slots_m), mission.swarm.vehicles
    if slots != vehicles:
        text = f"{vehicles} vehicles, but the formation has {slots} slots; accepted: {slots}"
        yield Problem("swarm", "vehicles", text)
    separation = mission.limits.separation_m
    if too_close(formation.smallest_separation_m, separation):
        text = (
            f"{separation:g} m, but the closest slots of the formation are {formation.smallest_separation_m:.2f} m "
            "apart; accepted: at most that, or a wider formation"
        )
        yield Problem("limits", "separation_m", text)
    try:
        places = formation.place(table.start())
    except ValueError as error:
        yield Problem("formation", "normal_enu", str(error))
        return
    excess = mission.fence.box().excess_m(places)
    if outside(excess.max()):
        text = f"slot {int(excess.argmax()) + 1} lies {excess.max():.2f} m outside the fence; accepted: a slot inside"
        yield Problem("formation", "centre_enu_m", text)


def _aim_problems(mission: Mission) -> Iterator[Problem]:
    """Yield what is wrong with the targets: a mission has [target] or [[targets]], not both."""
    if (mission.target is None) == (mission.targets is None):
        found = "missing" if mission.target is None else "given beside [[targets]]"
        yield Problem("target", "", f"{found}; accepted: either [target] or [[targets]]")
    elif mission.target is not None:
        if "track" in mission.model_fields_set:
            yield Problem("track", "", "has no effect without [[targets]]; accepted: both or neither")
        yield from _target_problems(mission.target, mission.fence.box())
    else:
        yield from target_problems_of(mission)


def _target_problems(table: TargetTable, fence: Fence) -> Iterator[Problem]:
    single, several = table.position_enu_m, table.positions_enu_m
    if (single is None) == (several is None):
        found = "missing" if single is None else "given beside positions_enu_m"
        yield Problem("target", "position_enu_m", f"{found}; accepted: either position_enu_m or positions_enu_m")
        return
    for key, other in (("weights", "positions_enu_m"), ("source", "positions_enu_m"), ("confidence", "sigma_m")):
        if key in table.model_fields_set and getattr(table, other) is None:
            yield Problem("target", key, f"has no effect without {other}; accepted: both or neither")
    if several is not None and table.weights is not None and len(table.weights) != len(several):
        text = f"{len(table.weights)} weights for {len(several)} positions; accepted: {len(several)} weights"
        yield Problem("target", "weights", text)
        return
    if single is not None:
        yield from _place_problems("position_enu_m", "", single, fence)
    for number, point in enumerate(several or (), start=1):
        yield from _place_problems("positions_enu_m", f"point {number}: ", point, fence)
    try:
        table.target()
    except PlanError as error:
        yield Problem("target", "", f"{error}; accepted: positions, weights and radii that a swarm can surround")


def _place_problems(key: str, which: str, point: Point, fence: Fence) -> Iterator[Problem]:
    floor = fence.low_enu_m[2]
    if point[2] < floor:
        text = f"{which}up = {point[2]:g} m lies below the floor; accepted: {floor:g} m or more ([fence] low_enu_m)"
        yield Problem("target", key, text)
    elif outside(float(fence.excess_m(np.array(point)))):
        yield Problem("target", key, f"{which}{list(point)} lies outside the fence; accepted: a point inside")


def _size_problems(mission: Mission) -> Iterator[Problem]:
    """Yield what is wrong with the formation at the size that the target requires; each is valid on its own."""
    formation, radius_m = mission.formation.formation(), mission.first_target().radius_m
    inscribed_m = formation.inscribed_radius_m
    if radius_m == 0.0:
        return
    table, key = _sized_by(mission)
    if inscribed_m == 0.0:
        text = "no circle around [0, 0] fits into the face; accepted: a rim around [0, 0], or no radius"
        yield Problem(table, key, text)
        return
    separation, closest_m = mission.limits.separation_m, formation.smallest_separation_m * radius_m / inscribed_m
    if too_close(closest_m, separation):
        least_m = math.ceil(100.0 * inscribed_m * separation / formation.smallest_separation_m) / 100.0
        text = (
            f"around a target of radius {radius_m:.2f} m the closest slots are {closest_m:.2f} m apart; "
            f"accepted: a radius of {least_m:.2f} m or more in all, or a smaller separation ([limits] separation_m)"
        )
        yield Problem(table, key, text)
    widest_m = math.dist(mission.fence.low_enu_m, mission.fence.high_enu_m) / 2.0
    if radius_m > widest_m:
        text = (
            f"a target of radius {radius_m:.2f} m does not fit inside the fence; accepted: a radius of at most "
            f"{widest_m:.2f} m in all, or a larger fence"
        )
        yield Problem(table, key, text)


def _sized_by(mission: Mission) -> tuple[str, str]:
    """Return the table and the key that contribute most directly to the radius of the target."""
    if mission.target is None:
        return "targets", "position_enu_m"
    if mission.target.radius_m > 0.0:
        return "target", "radius_m"
    return "target", "sigma_m" if mission.target.sigma_m is not None else "positions_enu_m"
