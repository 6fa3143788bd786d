"""Contradictions between keys of moving targets, each of which is valid on its own."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from fg_gcs.core.arrays import Array
from fg_gcs.errors import FgError, MissionError
from fg_gcs.mission.model import Mission
from fg_gcs.mission.tables import Problem
from fg_gcs.mission.target_tables import CsvSource, MovingTarget, ScriptSource, UdpSource, VehicleSource
from fg_gcs.plan.rules import outside

SIMULATED_KINDS = ("static", "waypoints", "circle", "figure_eight")  # that the simulator's target vehicles can fly
READ_BY = {  # keys of [targets.sensor] that have an effect, by kind of source; a sensor sees a simulated vehicle
    "script": {"rate_hz", "sigma_m", "delay_s", "jitter_s", "drop", "outliers", "outlier_m", "silence", "seed"},
    "simulated": {"rate_hz", "sigma_m", "delay_s", "drop", "outliers", "outlier_m", "silence", "seed"},
    "vehicle": {"sigma_m", "delay_s"},
    "csv": {"sigma_m"},
    "udp": {"sigma_m"},
}


class _Known(NamedTuple):
    """What is known of the motion of a target."""

    box_enu_m: Array  # (2, 3) corners [m; ENU]
    top_speed_m_s: float
    table: str  # that states it
    key: str


def target_problems_of(mission: Mission) -> Iterator[Problem]:
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
