"""What a vehicle is told: which message does what, and the small dialogues (time, parameters, empty mission).

`MESSAGES` has what every autopilot does; what one does in a way of its own it adds in its profile. Commands are in
`commands.py`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from types import MappingProxyType

from sitl_mock.autopilot.autopilot import Autopilot
from sitl_mock.autopilot.setpoints import LOCAL_NED, Interpretation, SetpointEffect, SetpointFields
from sitl_mock.messages import Received
from sitl_mock.physics.geodesy import Geodetic
from sitl_mock.protocol.commands import CUSTOM_MODE_BIT

GCS_TYPE = 6  # MAV_TYPE
PARAMETERS_PER_UPDATE = 20  # 50 updates a second: the 1,000 a second of the real ones
MISSION_ACCEPTED, MISSION_NO_SPACE, MISSION_BAD_SEQUENCE = 0, 4, 13  # MAV_MISSION_RESULT
POSITION_BITS = 0b111  # of a type mask
# Frames of SET_POSITION_TARGET_GLOBAL_INT: above home, above sea
HOME_FRAMES, SEA_FRAMES, TERRAIN_FRAMES = frozenset({3, 6}), frozenset({0, 5}), frozenset({10, 11})

Handler = Callable[[Autopilot, Received, int, float], None]


def addressed(vehicle: Autopilot, message: Received, system_0: bool) -> bool:
    """Whether target_system and target_component mean this vehicle; `system_0`: a broadcast does, too."""
    fields = message.fields
    return is_for(vehicle, fields["target_system"], fields.get("target_component", 0), system_0)


def is_for(vehicle: Autopilot, system: int, component: int, system_0: bool) -> bool:
    """The same, by the two numbers."""
    components = vehicle.profile.target_components
    mine = system == vehicle.system_id or (system == 0 and system_0)
    return mine and (components is None or component in components)


def _setpoint_local(vehicle: Autopilot, message: Received, link: int, now_s: float) -> None:
    # Both autopilots obey a setpoint to system 0: a broadcast setpoint moves every vehicle.
    _, x, y, z, u, v, w, a, b, c, yaw_rad, rate_rad_s, mask, system, component, frame = message.values
    if is_for(vehicle, system, component, system_0=True):
        fields = SetpointFields(mask, frame, (x, y, z), (u, v, w), (a, b, c), yaw_rad, rate_rad_s)
        vehicle.take_setpoint(fields, now_s)


def setpoint_global(vehicle: Autopilot, message: Received, link: int, now_s: float) -> None:
    """SET_POSITION_TARGET_GLOBAL_INT: as the local one, after its position was turned into local NED."""
    if not addressed(vehicle, message, system_0=True):
        return
    f = message.fields
    frame = int(f["coordinate_frame"])
    place = (0.0, 0.0, 0.0)
    if int(f["type_mask"]) & POSITION_BITS != POSITION_BITS:
        if frame not in HOME_FRAMES | SEA_FRAMES | TERRAIN_FRAMES:
            vehicle.act_on(Interpretation(SetpointEffect.BRAKE, text=f"Unknown mavlink coordinate frame {frame}"))
            return
        latitude_deg, longitude_deg, altitude_m = f["lat_int"] * 1e-7, f["lon_int"] * 1e-7, float(f["alt"])
        if abs(latitude_deg) > 90.0 or not math.isfinite(altitude_m):
            vehicle.act_on(Interpretation(SetpointEffect.BRAKE))
            return
        if frame not in SEA_FRAMES:
            altitude_m += vehicle.world.origin.altitude_m - vehicle.home_ned_m[2]
        north_m, east_m, down_m = vehicle.world.ned_m(Geodetic(latitude_deg, longitude_deg, altitude_m))
        o = vehicle.local_origin_ned_m
        place = (north_m - o[0], east_m - o[1], down_m - o[2])
    fields = {**f, "coordinate_frame": LOCAL_NED, "x": place[0], "y": place[1], "z": place[2]}
    vehicle.take_setpoint(SetpointFields.of(fields), now_s)


def _set_origin(vehicle: Autopilot, message: Received, link: int, now_s: float) -> None:
    f = message.fields
    if f["target_system"] != vehicle.system_id or abs(f["latitude"]) > 900_000_000:
        return
    point = Geodetic(f["latitude"] * 1e-7, f["longitude"] * 1e-7, f["altitude"] * 1e-3)
    vehicle.set_origin(vehicle.world.ned_m(point))


def _timesync(vehicle: Autopilot, message: Received, link: int, now_s: float) -> None:
    if message.fields["tc1"] == 0:
        vehicle.send(
            "TIMESYNC",
            {"tc1": round(vehicle.table.clock_s(vehicle.row, now_s) * 1e9), "ts1": message.fields["ts1"]},
            link,
        )


def set_mode_with(change: Callable[[Autopilot, int], object]) -> Handler:
    """Handle the old SET_MODE message: it works and is never acknowledged."""

    def handler(vehicle: Autopilot, message: Received, link: int, now_s: float) -> None:
        if message.fields["target_system"] in (vehicle.system_id, 0) and message.fields["base_mode"] & CUSTOM_MODE_BIT:
            change(vehicle, message.fields["custom_mode"])

    return handler


def parameters_addressed(vehicle: Autopilot, message: Received) -> bool:
    """Whether a message of the parameter protocol is for this vehicle."""
    return addressed(vehicle, message, vehicle.profile.obeys_system_0)


def requested_parameter(vehicle: Autopilot, message: Received) -> str:
    """The name that a PARAM_REQUEST_READ asks for by name or index; empty when there is no such index."""
    index = message.fields["param_index"]
    name: str = message.fields["param_id"] if index < 0 else vehicle.parameters.name_at(index) or ""
    return name


def begin_parameter_list(vehicle: Autopilot, message: Received, link: int, now_s: float) -> None:
    """PARAM_REQUEST_LIST: the list goes out with the next updates."""
    if parameters_addressed(vehicle, message):
        vehicle.links[link].parameter_index = 0


def continue_lists(vehicle: Autopilot) -> None:
    """Send the next parameters of every running list."""
    for index, link in enumerate(vehicle.links):
        for _ in range(PARAMETERS_PER_UPDATE):
            if link.parameter_index is None:
                break
            name = vehicle.parameters.name_at(link.parameter_index)
            if name is None:
                link.parameter_index = None
                break
            vehicle.send("PARAM_VALUE", vehicle.parameters.message(name, indexed=True), index)
            link.parameter_index += 1


def _mission_back(message: Received) -> dict[str, int]:
    kind = message.fields.get("mission_type", 0)
    return {"target_system": message.system, "target_component": message.component, "mission_type": kind}


def _mission_list(vehicle: Autopilot, message: Received, link: int, now_s: float) -> None:
    if addressed(vehicle, message, system_0=True):
        vehicle.send("MISSION_COUNT", {"count": 0, **_mission_back(message)}, link)


def _mission_clear(vehicle: Autopilot, message: Received, link: int, now_s: float) -> None:
    if addressed(vehicle, message, system_0=True):
        vehicle.send("MISSION_ACK", {"type": MISSION_ACCEPTED, **_mission_back(message)}, link)


def _mission_count(vehicle: Autopilot, message: Received, link: int, now_s: float) -> None:
    """An upload: an empty one clears, any other finds no space, for missions are not flown here."""
    if addressed(vehicle, message, system_0=True):
        kind = MISSION_ACCEPTED if message.fields["count"] == 0 else MISSION_NO_SPACE
        vehicle.send("MISSION_ACK", {"type": kind, **_mission_back(message)}, link)


def _mission_item(vehicle: Autopilot, message: Received, link: int, now_s: float) -> None:
    if addressed(vehicle, message, system_0=True):
        vehicle.send("MISSION_ACK", {"type": MISSION_BAD_SEQUENCE, **_mission_back(message)}, link)


MESSAGES: Mapping[str, Handler] = MappingProxyType(
    {
        "SET_POSITION_TARGET_LOCAL_NED": _setpoint_local,
        "SET_POSITION_TARGET_GLOBAL_INT": setpoint_global,
        "SET_GPS_GLOBAL_ORIGIN": _set_origin,
        "TIMESYNC": _timesync,
        "PARAM_REQUEST_LIST": begin_parameter_list,
        "MISSION_REQUEST_LIST": _mission_list,
        "MISSION_CLEAR_ALL": _mission_clear,
        "MISSION_COUNT": _mission_count,
        "MISSION_REQUEST": _mission_item,
        "MISSION_REQUEST_INT": _mission_item,
    }
)
