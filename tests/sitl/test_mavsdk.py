"""MAVSDK, which knows nothing of this simulator, flies it as it flies PX4."""

from __future__ import annotations

import asyncio
import math
from collections.abc import AsyncGenerator, Callable
from contextlib import aclosing
from typing import TypeVar

from mavsdk.asyncio import ComponentType, Configuration, Mavsdk
from mavsdk.asyncio.plugins.action import ActionAsync
from mavsdk.asyncio.plugins.offboard import OffboardAsync, PositionNedYaw
from mavsdk.asyncio.plugins.telemetry import LandedState, PositionVelocityNed, TelemetryAsync

from tests.sitl.process import free_udp_port, simulator

PATIENCE_S = 120.0  # each phase takes at most 14 s on a quiet machine
GOAL_M = (4.0, -3.0, -5.0)
Value = TypeVar("Value")


async def until(values: AsyncGenerator[Value, None], condition: Callable[[Value], bool]) -> None:
    """Wait for a value that satisfies the condition."""
    async with asyncio.timeout(PATIENCE_S), aclosing(values):
        async for value in values:
            if condition(value):
                return


def at_goal(state: PositionVelocityNed) -> bool:
    place = state.position
    return math.dist((place.north_m, place.east_m, place.down_m), GOAL_M) < 0.5


async def fly(port: int) -> None:
    configuration = Configuration.create_with_component_type(ComponentType.GROUND_STATION)
    async with Mavsdk(configuration) as mavsdk:
        await mavsdk.add_any_connection(f"udpin://127.0.0.1:{port}")
        system = await mavsdk.first_autopilot(timeout_s=PATIENCE_S)
        assert system is not None
        telemetry, action, offboard = TelemetryAsync(system), ActionAsync(system), OffboardAsync(system)
        await until(telemetry.subscribe_health_all_ok(), bool)
        assert (await telemetry.health()).is_armable
        await action.arm()
        await until(telemetry.subscribe_armed(), bool)
        await action.takeoff()
        await until(telemetry.subscribe_landed_state(), lambda state: state == LandedState.IN_AIR)
        await offboard.set_position_ned(PositionNedYaw(*GOAL_M, 90.0))
        await offboard.start()
        await until(telemetry.subscribe_position_velocity_ned(), at_goal)
        assert await offboard.is_active()
        await action.land()
        await until(telemetry.subscribe_armed(), lambda armed: not armed)
        assert await telemetry.landed_state() == LandedState.ON_GROUND
        for plugin in (telemetry, action, offboard):
            plugin.destroy()


def test_mavsdk_arms_takes_off_flies_offboard_and_lands() -> None:
    port = free_udp_port()
    with simulator("--remote", f"127.0.0.1:{port}"):
        asyncio.run(fly(port))
