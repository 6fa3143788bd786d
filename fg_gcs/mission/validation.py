"""Contradictions between keys of a mission, each of which is valid on its own."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from fg_gcs.core.arrays import Array
from fg_gcs.core.separation import Fence
from fg_gcs.errors import FgError, MissionError, PlanError
from fg_gcs.mission.model import Mission, TargetTable
from fg_gcs.mission.tables import Point, Problem
from fg_gcs.mission.target_tables import CsvSource, MovingTarget, ScriptSource, UdpSource, VehicleSource
from fg_gcs.plan.rules import outside, too_close

SIMULATED_KINDS = ("static", "waypoints", "circle", "figure_eight")  # that the simulator's target vehicles can fly
READ_BY = {  # keys of [targets.sensor] that have an effect, by kind of source; a sensor sees a simulated vehicle
    "script": {"rate_hz", "sigma_m", "delay_s", "jitter_s", "drop", "outliers", "outlier_m", "silence", "seed"},
    "simulated": {"rate_hz", "sigma_m", "delay_s", "drop", "outliers", "outlier_m", "silence", "seed"},
    "vehicle": {"sigma_m", "delay_s"},
    "csv": {"sigma_m"},
    "udp": {"sigma_m"},
}


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
    separation, fault_separation = mission.limits.separation_m, mission.limits.fault_least_m
    if fault_separation > separation:
        text = f"{fault_separation:g} m; accepted: at most {separation:g} m ([limits] separation_m)"
        yield Problem("limits", "fault_separation_m", text)
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
        formation = table.formation(mission.limits.separation_m)
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
        yield from _tracking_problems(mission)


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
    formation, radius_m = mission.formation.formation(mission.limits.separation_m), mission.first_target().radius_m
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


# --- moving targets ---------------------------------------------------------------------------------------------------


class _Known(NamedTuple):
    """What is known of the motion of a target."""

    box_enu_m: Array  # (2, 3) corners [m; ENU]
    top_speed_m_s: float
    table: str  # that states it
    key: str


def _tracking_problems(mission: Mission) -> Iterator[Problem]:
    """Yield what is wrong with a mission's moving targets, their sources and their sensors."""
    targets = mission.targets or []
    if mission.plan.formulation != "rigid":
        text = f'"{mission.plan.formulation}" cannot follow moving targets; accepted: "rigid"'
        yield Problem("plan", "formulation", text)
    found = [*_shared(mission, targets)]
    ways: list[_Known] = []
    for number, target in enumerate(targets, start=1):
        problems = [*_source_problems(target, number), *_sensor_problems(target, number)]
        if not problems:
            known = _known(target, number)
            ways += [known] if isinstance(known, _Known) else []
            problems += [known] if isinstance(known, Problem) else [*_way_problems(mission, known, number)]
        found += problems
    yield from found
    if not found:
        yield from _reach_problems(mission, ways)


def _of(key: str, number: int) -> str:
    return f"{key} of target {number}"


def _shared(mission: Mission, targets: Sequence[MovingTarget]) -> Iterator[Problem]:
    """Yield names, ports and system ids that several targets share."""
    names = Counter(target.name for target in targets)
    swarm = set(mission.swarm.ids())
    ports: dict[int, str] = {}  # vehicles may share one: their system ids tell them apart
    ids: set[int] = set()
    for number, target in enumerate(targets, start=1):
        source = target.source
        if names[target.name] > 1:
            text = f'"{target.name}" occurs {names[target.name]} times; accepted: a different name for every target'
            yield Problem("targets", _of("name", number), text)
        if isinstance(source, VehicleSource):
            if source.system_id in swarm | ids:
                text = f"{source.system_id} is used by another vehicle; accepted: an id that no other vehicle uses"
                yield Problem("targets.source", _of("system_id", number), text)
            ids.add(source.system_id)
        if isinstance(source, UdpSource | VehicleSource) and source.endpoint is not None:
            port = int(source.endpoint.rpartition(":")[2])
            if not 0 < port < 65536:
                yield Problem(
                    "targets.source", _of("endpoint", number), f"got port {port}; accepted: a port from 1 to 65535"
                )
            elif ports.get(port, "vehicle") != "vehicle" or (port in ports and source.kind != "vehicle"):
                text = f"port {port} is used by another source; accepted: a port that no other source uses"
                yield Problem("targets.source", _of("endpoint", number), text)
            ports[port] = source.kind


def _source_problems(target: MovingTarget, number: int) -> Iterator[Problem]:
    source, simulated = target.source, target.simulated
    if isinstance(source, ScriptSource) or simulated:
        if target.motion is None:
            what = "the simulated vehicle flies" if simulated else "the sensor sees"
            yield Problem("targets", _of("motion", number), f"missing; accepted: a table with the motion that {what}")
        elif simulated and target.motion.kind not in SIMULATED_KINDS:
            accepted = ", ".join(f'"{kind}"' for kind in SIMULATED_KINDS)
            text = f'simulated vehicles do not fly "{target.motion.kind}"; accepted: {accepted}'
            yield Problem("targets.motion", _of("kind", number), text)
    else:
        if target.motion is not None:
            text = f'has no effect with a source of kind "{source.kind}"; accepted: either a motion or that source'
            yield Problem("targets", _of("motion", number), text)
        if target.position_enu_m is None and not isinstance(source, CsvSource):
            text = "missing; accepted: [east, north, up] in metres, where the target is expected at first"
            yield Problem("targets", _of("position_enu_m", number), text)
    if isinstance(source, VehicleSource) and (source.endpoint is None) != simulated:
        text = "missing; accepted: " if source.endpoint is None else "has no effect with simulated = true; accepted: "
        text += '"udpin:HOST:PORT" for a real vehicle, no endpoint for a simulated one'
        yield Problem("targets.source", _of("endpoint", number), text)


def _sensor_problems(target: MovingTarget, number: int) -> Iterator[Problem]:
    kind = "simulated" if target.simulated else target.source.kind
    for key in sorted(target.sensor.model_fields_set - READ_BY[kind]):
        accepted = ", ".join(sorted(READ_BY[kind]))
        text = f'has no effect with a source of kind "{target.source.kind}"; accepted keys: {accepted}'
        yield Problem("targets.sensor", _of(key, number), text)
    for begin_s, end_s in target.sensor.silence:
        if not begin_s < end_s:
            text = f"got [{begin_s:g}, {end_s:g}]; accepted: [from, to] with from below to"
            yield Problem("targets.sensor", _of("silence", number), text)


def _known(target: MovingTarget, number: int) -> _Known | Problem:
    """Return what is known of the motion of a target, or what is wrong with it."""
    from_file = isinstance(target.source, CsvSource)
    table = "targets.source" if from_file else "targets.motion"
    try:
        with np.errstate(over="ignore", invalid="ignore"):  # absurd positions are outside every fence
            motion, first = target.true_motion(), target.first_enu_m()
        seen = np.array([row.position_enu_m for row in target.replay()]).reshape(-1, 3)
    except MissionError as error:
        return Problem(table, _of("path", number), str(error))
    except ValueError as error:
        return Problem(table, _of("kind", number), str(error))
    places = [first[None], seen, np.empty((0, 3)) if motion is None else motion.box_enu_m]
    every = np.concatenate(places)
    if not np.isfinite(every).all():
        return Problem(table, _of("kind", number), "the numbers are too large; accepted: positions inside the fence")
    box = np.array([every.min(axis=0), every.max(axis=0)])
    if motion is None:
        return _Known(box, 0.0, *(("targets.source", "path") if from_file else ("targets", "position_enu_m")))
    return _Known(box, motion.top_speed_m_s, "targets.motion", "kind")


def _way_problems(mission: Mission, known: _Known, number: int) -> Iterator[Problem]:
    """Yield what is wrong with the motion of one target on its own."""
    excess_m = float(mission.fence.box().excess_m(known.box_enu_m).max())
    if outside(excess_m):
        text = f"leaves the fence by up to {excess_m:.2f} m; accepted: positions inside, or a larger fence"
        yield Problem(known.table, _of(known.key, number), text)
    limit_m_s = mission.limits.speed_m_s
    if known.top_speed_m_s >= limit_m_s:
        text = (
            f"moves at up to {known.top_speed_m_s:.2f} m/s; accepted: less than the swarm's {limit_m_s:g} m/s "
            "([limits] speed_m_s)"
        )
        yield Problem(known.table, _of(known.key, number), text)


def _reach_problems(mission: Mission, ways: Sequence[_Known]) -> Iterator[Problem]:
    """Yield a problem if the formation around the centre of the targets would leave the fence.

    The centre lies in the weighted mean of the targets' boxes; the direction that the formation faces is not known.
    """
    try:
        task = mission.task()
        reach_m = float(np.linalg.norm(task.formation.slots_m, axis=1).max()) * max(task.last_scale, 1.0)
    except (ValueError, FgError):
        return  # the formation or its size is at fault, and reported as such
    reach_m += mission.hold.depth_m
    weights = [target.weight for target in mission.targets or []]
    low, high = np.average([way.box_enu_m for way in ways], axis=0, weights=weights)
    excess_m = float(mission.fence.box().excess_m(np.array([low - reach_m, high + reach_m])).max())
    if outside(excess_m):
        text = (
            f"the formation around it reaches {reach_m:.2f} m, up to {excess_m:.2f} m out of the fence; "
            "accepted: positions that much further inside, or a larger fence"
        )
        yield Problem(ways[0].table, _of(ways[0].key, 1), text)
