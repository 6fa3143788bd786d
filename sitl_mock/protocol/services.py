"""Everything a vehicle hears: which message does what, and the small dialogues (time, parameters, empty mission)."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from types import MappingProxyType

from sitl_mock.autopilot.autopilot import Autopilot
from sitl_mock.autopilot.parameters import UNINDEXED, WriteRefused
from sitl_mock.autopilot.profiles import DATA_STREAM_ALL, DATA_STREAMS
from sitl_mock.autopilot.setpoints import (
    Situation,
    Understood,
    Verdict,
    Wish,
    understand_ardupilot,
    understand_px4,
)
from sitl_mock.messages import Outgoing, Received
from sitl_mock.physics.geodesy import Geodetic
from sitl_mock.protocol import commands

GCS_TYPE, OWN_COMPONENT = 6, 1
PX4_ECHO_S = 0.01  # PX4 tells a changed parameter a second time, to every link, after its next update
ARDUPILOT_READ_S = 0.08  # ArduPilot answers parameter reads from a 10 Hz task: 63-99 ms
PARAMETER_HASH = 0x5349544C  # `_HASH_CHECK` of a PX4 list; constant, since nobody compares it here
UINT32_TYPE = 5
PARAMETERS_PER_UPDATE = 20  # 50 updates a second: the 1,000 a second of the real ones
MISSION_ACCEPTED, MISSION_NO_SPACE, MISSION_BAD_SEQUENCE = 0, 4, 13
OFFSET_BITS = 0b111  # the position bits of a type mask
# Frames of SET_POSITION_TARGET_GLOBAL_INT: above home, above sea
HOME_FRAMES, SEA_FRAMES, TERRAIN_FRAMES = frozenset({3, 6}), frozenset({0, 5}), frozenset({10, 11})
PX4_GLOBAL_FRAMES = frozenset({5, 6, 11})
LOCAL_NED = 1

Handler = Callable[[Autopilot, Received, int, float], None]


def hear(vehicle: Autopilot, message: Received, link: int, now_s: float) -> None:
    """Let a vehicle act on one message that arrived on a link."""
    handler = HANDLERS.get(message.name)
    if not vehicle.profile.texts_need_gcs:
        vehicle.links[link].texts_open = True  # ArduPilot: any frame opens the channel's texts
    if handler is not None and now_s >= vehicle.boot.heartbeat_s:
        handler(vehicle, message, link, now_s)


def _addressed(vehicle: Autopilot, message: Received, system_0: bool) -> bool:
    """Whether target_system and target_component mean this vehicle, as its autopilot sees it."""
    system, component = message.fields["target_system"], message.fields.get("target_component", 0)
    components = vehicle.profile.target_components
    mine = system == vehicle.system_id or (system == 0 and system_0)
    return mine and (components is None or component in components)


def _heartbeat(vehicle: Autopilot, message: Received, link: int, now_s: float) -> None:
    if message.fields["type"] == GCS_TYPE:
        vehicle.links[link].texts_open = True
    if vehicle.profile.is_px4:
        if message.fields["type"] == GCS_TYPE:
            vehicle.gcs_heard_at_s = now_s
    elif message.system == vehicle.parameters["MAV_GCS_SYSID"]:
        vehicle.gcs_heard_at_s = now_s


def _command(vehicle: Autopilot, message: Received, link: int, now_s: float) -> None:
    if _addressed(vehicle, message, vehicle.profile.obeys_system_0):
        commands.execute(vehicle, commands.command_of(message, link))


def _set_mode(vehicle: Autopilot, message: Received, link: int, now_s: float) -> None:
    """The old SET_MODE message: works, never acknowledged."""
    if message.fields["target_system"] in (vehicle.system_id, 0) and message.fields["base_mode"] & 1:
        commands.set_mode_number(vehicle, message.fields["custom_mode"])


def _setpoint_local(vehicle: Autopilot, message: Received, link: int, now_s: float) -> None:
    # Both autopilots obey a setpoint to system 0: a broadcast setpoint moves everybody.
    if _addressed(vehicle, message, system_0=True):
        _obey(vehicle, Wish.of(message.fields), now_s)


def _setpoint_global(vehicle: Autopilot, message: Received, link: int, now_s: float) -> None:
    if not _addressed(vehicle, message, system_0=True):
        return
    f = message.fields
    frame, mask = int(f["coordinate_frame"]), int(f["type_mask"])
    px4 = vehicle.profile.is_px4
    if px4 and frame not in PX4_GLOBAL_FRAMES:
        text = f"SET_POSITION_TARGET_GLOBAL_INT invalid coordinate frame {frame}"
        vehicle.obey(Understood(Verdict.INVALID, text=text))
        return
    place = (0.0, 0.0, 0.0)
    if mask & OFFSET_BITS != OFFSET_BITS:
        if frame not in HOME_FRAMES | SEA_FRAMES | TERRAIN_FRAMES:
            vehicle.obey(Understood(Verdict.BRAKE, text=f"Unknown mavlink coordinate frame {frame}"))
            return
        latitude_deg, longitude_deg, altitude_m = f["lat_int"] * 1e-7, f["lon_int"] * 1e-7, float(f["alt"])
        if abs(latitude_deg) > 90.0 or not math.isfinite(altitude_m):
            vehicle.obey(Understood(Verdict.BRAKE))
            return
        if frame not in SEA_FRAMES:
            altitude_m += vehicle.world.origin.altitude_m - vehicle.home_ned_m[2]
        north_m, east_m, down_m = vehicle.world.ned_m(Geodetic(latitude_deg, longitude_deg, altitude_m))
        o = vehicle.local_origin_ned_m
        place = (north_m - o[0], east_m - o[1], down_m - o[2])
    fields = {**f, "coordinate_frame": LOCAL_NED, "x": place[0], "y": place[1], "z": place[2]}
    _obey(vehicle, Wish.of(fields), now_s)


def _obey(vehicle: Autopilot, wish: Wish, now_s: float) -> None:
    situation = Situation(now_s, vehicle.local_origin_ned_m, vehicle.body.position_m, vehicle.body.yaw_rad)
    carry_s = vehicle.profile.carry_s
    if carry_s is not None:
        vehicle.obey(understand_px4(wish, situation, carry_s))
    else:
        vehicle.obey(understand_ardupilot(wish, situation, max(vehicle.parameters["GUID_TIMEOUT"], 0.1)))


def _set_origin(vehicle: Autopilot, message: Received, link: int, now_s: float) -> None:
    f = message.fields
    if f["target_system"] != vehicle.system_id or abs(f["latitude"]) > 900_000_000:
        return
    point = Geodetic(f["latitude"] * 1e-7, f["longitude"] * 1e-7, f["altitude"] * 1e-3)
    vehicle.set_origin(vehicle.world.ned_m(point))


def _data_stream(vehicle: Autopilot, message: Received, link: int, now_s: float) -> None:
    if vehicle.profile.is_px4 or not _addressed(vehicle, message, system_0=True):
        return  # PX4 ignores it
    number, rate_hz = message.fields["req_stream_id"], message.fields["req_message_rate"]
    period_s = 1.0 / rate_hz if message.fields["start_stop"] and rate_hz else None
    groups = DATA_STREAMS.values() if number == DATA_STREAM_ALL else (DATA_STREAMS.get(number, ()),)
    for group in groups:
        for name in group:
            vehicle.links[link].set_interval(name, period_s, now_s)


def _timesync(vehicle: Autopilot, message: Received, link: int, now_s: float) -> None:
    if message.fields["tc1"] == 0:
        vehicle.send("TIMESYNC", {"tc1": round(now_s * 1e9), "ts1": message.fields["ts1"]}, link)


def _ping(vehicle: Autopilot, message: Received, link: int, now_s: float) -> None:
    f = message.fields
    if f["target_system"] == 0 and vehicle.profile.is_px4:
        back = {"target_system": message.system, "target_component": message.component}
        vehicle.send("PING", {"time_usec": f["time_usec"], "seq": f["seq"], **back}, link)


def _parameter_list(vehicle: Autopilot, message: Received, link: int, now_s: float) -> None:
    if not _addressed(vehicle, message, system_0=not vehicle.profile.is_px4):
        return
    vehicle.links[link].parameter_index = 0
    if vehicle.profile.parameters_bytewise:
        fields = {
            "param_id": b"_HASH_CHECK",
            "param_value": float(PARAMETER_HASH & 0x7FFFFF),
            "param_type": UINT32_TYPE,
            "param_count": len(vehicle.parameters),
            "param_index": UNINDEXED,
        }
        vehicle.send("PARAM_VALUE", fields, link)


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


def _parameter_read(vehicle: Autopilot, message: Received, link: int, now_s: float) -> None:
    if not _addressed(vehicle, message, system_0=not vehicle.profile.is_px4):
        return
    index = message.fields["param_index"]
    name = message.fields["param_id"] if index < 0 else vehicle.parameters.name_at(index)
    if name is None or name not in vehicle.parameters:
        if vehicle.profile.parameters_bytewise:
            _parameter_error(vehicle, message, name or "", link, 1)
        return
    indexed = vehicle.profile.parameters_bytewise or index >= 0
    answer = Outgoing("PARAM_VALUE", vehicle.parameters.message(name, indexed), link)
    if vehicle.profile.parameters_bytewise:
        vehicle.outbox.append(answer)
    else:
        vehicle.send_later(now_s + ARDUPILOT_READ_S, answer)


def _parameter_set(vehicle: Autopilot, message: Received, link: int, now_s: float) -> None:
    if not _addressed(vehicle, message, system_0=not vehicle.profile.is_px4):
        return
    f = message.fields
    name = f["param_id"]
    try:
        changed = vehicle.parameters.write(name, f["param_value"], f["param_type"])
    except WriteRefused as refusal:
        if refusal.error is not None:
            _parameter_error(vehicle, message, name, link, refusal.error)
        return
    answer = vehicle.parameters.message(name, indexed=vehicle.profile.parameters_bytewise)
    vehicle.send("PARAM_VALUE", answer, link)
    if changed and vehicle.profile.parameters_bytewise:
        vehicle.send_later(now_s + PX4_ECHO_S, Outgoing("PARAM_VALUE", answer))
    if name == "MAV_SYSID":
        vehicle.system_id = min(max(int(vehicle.parameters[name]), 1), 255)  # at once, as ArduPilot does


def _parameter_error(vehicle: Autopilot, message: Received, name: str, link: int, error: int) -> None:
    back = {"target_system": message.system, "target_component": message.component}
    fields = {"param_id": name.encode("ascii", "replace"), "param_index": 0, "error": error}
    vehicle.send("PARAM_ERROR", back | fields, link)


def _mission_back(message: Received) -> dict[str, int]:
    kind = message.fields.get("mission_type", 0)
    return {"target_system": message.system, "target_component": message.component, "mission_type": kind}


def _mission_list(vehicle: Autopilot, message: Received, link: int, now_s: float) -> None:
    if _addressed(vehicle, message, system_0=True):
        vehicle.send("MISSION_COUNT", {"count": 0, **_mission_back(message)}, link)


def _mission_clear(vehicle: Autopilot, message: Received, link: int, now_s: float) -> None:
    if _addressed(vehicle, message, system_0=True):
        vehicle.send("MISSION_ACK", {"type": MISSION_ACCEPTED, **_mission_back(message)}, link)


def _mission_count(vehicle: Autopilot, message: Received, link: int, now_s: float) -> None:
    """An upload: an empty one clears, any other finds no space, for missions are not flown here."""
    if _addressed(vehicle, message, system_0=True):
        kind = MISSION_ACCEPTED if message.fields["count"] == 0 else MISSION_NO_SPACE
        vehicle.send("MISSION_ACK", {"type": kind, **_mission_back(message)}, link)


def _mission_item(vehicle: Autopilot, message: Received, link: int, now_s: float) -> None:
    if _addressed(vehicle, message, system_0=True):
        vehicle.send("MISSION_ACK", {"type": MISSION_BAD_SEQUENCE, **_mission_back(message)}, link)


HANDLERS: Mapping[str, Handler] = MappingProxyType(
    {
        "HEARTBEAT": _heartbeat,
        "COMMAND_LONG": _command,
        "COMMAND_INT": _command,
        "SET_MODE": _set_mode,
        "SET_POSITION_TARGET_LOCAL_NED": _setpoint_local,
        "SET_POSITION_TARGET_GLOBAL_INT": _setpoint_global,
        "SET_GPS_GLOBAL_ORIGIN": _set_origin,
        "REQUEST_DATA_STREAM": _data_stream,
        "TIMESYNC": _timesync,
        "PING": _ping,
        "PARAM_REQUEST_LIST": _parameter_list,
        "PARAM_REQUEST_READ": _parameter_read,
        "PARAM_SET": _parameter_set,
        "MISSION_REQUEST_LIST": _mission_list,
        "MISSION_CLEAR_ALL": _mission_clear,
        "MISSION_COUNT": _mission_count,
        "MISSION_REQUEST": _mission_item,
        "MISSION_REQUEST_INT": _mission_item,
    }
)
