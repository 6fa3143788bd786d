"""The simulator on UDP: every vehicle with its own socket per remote, one clock, no threads.

Its clock is that of the event loop it is started on. It uses nothing of that loop but `time`, `call_at` and
`create_datagram_endpoint`, so that it runs unchanged on any asyncio loop, and on one whose time is virtual: the same
seed and the same datagrams then give the same bytes.
"""

from __future__ import annotations

import asyncio
import math
from contextlib import suppress
from dataclasses import dataclass
from enum import IntEnum
from pathlib import Path
from typing import Any, Self, cast

import numpy as np
from numpy.typing import NDArray

from sitl_mock.faults.impairments import FROM_VEHICLE, TO_VEHICLE, Impairments
from sitl_mock.faults.incidents import write_truth
from sitl_mock.faults.schema import ImpairmentOptions, check_vehicles
from sitl_mock.host.clock import SimulatedClock
from sitl_mock.host.fleet import Fleet, FleetOptions, Sent, check_system_ids
from sitl_mock.host.lateness import Lateness
from sitl_mock.host.targets import TargetOptions, Targets
from sitl_mock.links import DUE_SLACK_S
from sitl_mock.messages import CommandResult, Fields
from sitl_mock.physics.swarm import enu_from_ned
from sitl_mock.protocol.codec import first_message_id
from sitl_mock.protocol.layouts import layout

HOST = "127.0.0.1"  # simulated vehicles stay on this machine
PARTNER_SILENT_S = 5.0  # newer PX4 lets a client come back from a new port (its pull request 28518); the time is ours
REMOTE_PORT_STEP = 3990  # PX4's first links are at 18570 + k and 14580 + k
Address = tuple[str, int]

# COMMAND_LONG with this number (MAV_CMD_USER_1) is about time where `lockstep` is set, to any vehicle on any link:
# param1 is a `TimeAction`, param2 of a step is how long it is [s]. Its COMMAND_ACK comes behind all that was said
# meanwhile, and has the simulated time in `result_param2` [ms].
TIME_COMMAND = 31010
LONGEST_STEP_S = 10.0  # other clients wait while it is computed


class TimeAction(IntEnum):
    """What is to become of simulated time."""

    RUN = 0
    PAUSE = 1
    STEP = 2


class PortUnavailable(Exception):
    """A local port cannot be bound.

    Args:
        port: its number.
        reason: what the system says.
    """

    def __init__(self, port: int, reason: str) -> None:
        self.port = port
        super().__init__(
            f"port {port} on {HOST} cannot be used: {reason}; choose another port base (0: any free ports)"
        )


@dataclass(frozen=True)
class SimulatorOptions(FleetOptions):
    """What to simulate, and where to send it.

    Attributes:
        remotes: where telemetry goes; each is a link of its own.
        port_base: vehicle k listens on port_base + k for the first remote, 3990 lower for each further; 0: any free
            ports.
        speed: simulated seconds per second of the event loop; infinity: as fast as they are computed.
        lockstep: time stands still at first, and goes as commands say, see `TIME_COMMAND`.
        targets: vehicles to be followed; their ports come after those of the vehicles.
        impairments: of the links of vehicles and targets, see `sitl_mock.parse_impairment`.
        truth: a JSON file for what vehicles truly hit and how close they came; written at each incident and at the end.

    Raises:
        ValueError: options that contradict each other or mean nothing; one line that says which.
    """

    remotes: tuple[Address, ...] = ((HOST, 14550),)
    port_base: int = 0
    speed: float = 1.0
    lockstep: bool = False
    targets: tuple[TargetOptions, ...] = ()
    impairments: tuple[ImpairmentOptions, ...] = ()
    truth: Path | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        check_system_ids(self.all_ids)
        for impairment in self.impairments:
            check_vehicles(impairment.window, self.all_ids)
        if not self.speed > 0.0:
            raise ValueError(f"the speed must be greater than 0: {self.speed:g}")
        if not self.remotes:
            raise ValueError("there must be at least one remote")
        if self.lockstep and not self.system_ids:
            raise ValueError("in lockstep there must be at least one vehicle: it takes the commands that let time go")

    @property
    def all_ids(self) -> tuple[int, ...]:
        """System ids of the vehicles, then of the targets."""
        return (*self.system_ids, *(target.system_id for target in self.targets))

    def local_port(self, vehicle: int, link: int) -> int:
        """The port that a vehicle binds for a remote; 0 lets the system choose."""
        return self.port_base + vehicle - REMOTE_PORT_STEP * link if self.port_base else 0


@dataclass(frozen=True, slots=True)
class Counters:
    """What went wrong so far, over all vehicles."""

    bad_bytes: int  # received in no valid frame
    dropped: int  # datagrams from senders that a vehicle does not listen to
    unsendable: int  # messages whose numbers did not fit their fields
    send_errors: int  # reported by the system
    slipped_s: float  # simulated time that never happened, because stalls were too long to make up
    not_signed: int = 0  # frames refused because of their signature: none, a wrong one, or one that came before


class _Port(asyncio.DatagramProtocol):
    """One vehicle's socket for one remote."""

    def __init__(self, simulator: Simulator, vehicle: int, link: int, remote: Address) -> None:
        self._simulator = simulator
        self._vehicle, self._link = vehicle, link
        self._partner = remote
        # The first sender becomes the partner, for good or until it falls silent; else only the remote is listened to.
        self._sticky = simulator.fleet.profile.first_sender_is_partner
        self._replaced = simulator.options.manners.new_partner
        self._heard_s: float | None = None  # the partner
        self._settled = False  # nothing that the partner sends can change who it is
        self._transport: asyncio.DatagramTransport | None = None
        self.dropped = 0
        self.errors = 0

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        # By contract; before Python 3.12 the real class does not derive from it, so nothing can be asserted.
        self._transport = cast(asyncio.DatagramTransport, transport)

    def datagram_received(self, data: bytes, addr: tuple[str | Any, int]) -> None:
        if not self._settled or addr != self._partner:
            sender = (str(addr[0]), int(addr[1]))
            if not self._listens_to(sender):
                self.dropped += 1
                return
        self._simulator.receive(self._vehicle, self._link, data)

    def _listens_to(self, sender: Address) -> bool:
        """Whether a sender is obeyed; telemetry may go there from now on."""
        now_s = self._simulator.now_s
        if not self._sticky:
            return sender == self._partner
        silent_s = math.inf if self._heard_s is None else now_s - self._heard_s if self._replaced else 0.0
        if silent_s > PARTNER_SILENT_S or self._simulator.is_frozen(self._vehicle, self._link):
            self._partner = sender
        if sender == self._partner:
            self._heard_s = now_s
            self._settled = not self._replaced and not self._simulator.options.manners.parameter_freeze
        return True

    def error_received(self, exc: Exception) -> None:
        self.errors += 1

    def send(self, data: bytes) -> None:
        if self._transport is not None and not self._transport.is_closing():
            self._transport.sendto(data, self._partner)

    @property
    def number(self) -> int:
        return int(self._transport.get_extra_info("sockname")[1]) if self._transport is not None else 0

    def close(self) -> None:
        if self._transport is not None:
            self._transport.close()


class Simulator:
    """Simulated vehicles on sockets of their own, beside whatever else runs on the event loop.

        async with Simulator(SimulatorOptions(pads_enu_m=grid(10))) as simulator:
            ...  # ten vehicles talk to 127.0.0.1:14550, and listen on simulator.ports

    It can be started once, by `async with` or by `start` and `close`. True states can be read at any time.

    Args:
        options: what to simulate.

    Attributes:
        lateness: of ticks, by the clock of the loop; nothing where time does not go by itself.
    """

    def __init__(self, options: SimulatorOptions) -> None:
        self.options = options
        self.lateness = Lateness()
        self.fleet = Fleet(options, len(options.remotes))
        self.targets = Targets(options.targets, len(options.remotes), options.origin_deg_m)
        links = len(options.remotes)
        self._impairments = Impairments(options.impairments, options.all_ids, links, self.fleet.stages, options.seed)
        self._ports: list[list[_Port]] = []  # [vehicle, then target][link]
        self._written = 0  # incidents
        self._closed = False
        self._delivery: asyncio.TimerHandle | None = None
        self._loop: asyncio.AbstractEventLoop | None = None  # once it was started
        self._clock: SimulatedClock | None = None  # likewise
        self._timer: asyncio.Handle | None = None
        self._number, self._due_s = 0, 0.0  # of the next tick, and when it is due by the loop, if time goes by itself

    async def __aenter__(self) -> Self:
        """Start.

        Raises:
            PortUnavailable: a port is taken; nothing is left open.
        """
        await self.start()
        return self

    async def __aexit__(self, *error: object) -> None:
        """Close."""
        await self.close()

    async def start(self) -> None:
        """Bind every socket and let time run, by the clock of the running event loop.

        Raises:
            PortUnavailable: a port is taken; nothing is left open.
            RuntimeError: it was started before.
        """
        if self._ports:
            raise RuntimeError("a simulator can be started only once")
        loop = asyncio.get_running_loop()
        try:
            for vehicle in range(len(self.options.system_ids) + len(self.options.targets)):
                self._ports.append([])
                for link, remote in enumerate(self.options.remotes):
                    port = _Port(self, vehicle, link, remote)
                    await _bind(loop, port, self.options.local_port(vehicle, link), self.options.remotes)
                    self._ports[vehicle].append(port)
        except PortUnavailable:
            await self.close()
            raise
        self._loop = loop
        self._clock = SimulatedClock(loop.time, self.options.speed, paused=self.options.lockstep)
        self._schedule_tick()

    async def close(self) -> None:
        """Stop time and close every socket; once is enough, more do no harm."""
        self._cancel_timers()
        if self._clock is not None:
            self._write_truth()
            self._clock.pause()  # its time is over
            self._closed = True
        for ports in self._ports:
            for port in ports:
                port.close()
        await asyncio.sleep(0)  # transports close at the next turn of the loop

    def receive(self, vehicle: int, link: int, data: bytes) -> None:
        """Answer a datagram at once, at the present simulated time. Targets ignore what they receive."""
        now_s = self._advance()
        if vehicle >= len(self.fleet.vehicles) or self._controlled(vehicle, link, data):
            return
        if self._impairments.concern(vehicle, TO_VEHICLE):
            self._impairments.send(vehicle, link, TO_VEHICLE, data, now_s)
            self._deliver(now_s)
        else:
            self._send(self.fleet.receive(vehicle, link, data, now_s), now_s)

    def is_frozen(self, vehicle: int, link: int) -> bool:
        """Whether a vehicle has forgotten its partner on a link, see `Manners.parameter_freeze`."""
        if vehicle >= len(self.fleet.vehicles):
            return False
        return math.isfinite(self.fleet.vehicles[vehicle].autopilot.links[link].frozen_s)

    def begin_stage(self, stage: str) -> None:
        """The flight comes to a stage that faults or impairments may wait for.

        Raises:
            ValueError: there is no such stage.
        """
        self.fleet.stages.begin(stage, self.now_s)

    @property
    def ports(self) -> tuple[int, ...]:
        """The local ports of the first remote, one per vehicle and target."""
        return tuple(ports[0].number for ports in self._ports)

    @property
    def positions_enu_m(self) -> NDArray[np.float64]:
        """(V, 3) true positions, world ENU [m]."""
        return enu_from_ned(self.fleet.swarm.position_m)

    @property
    def velocities_enu_m_s(self) -> NDArray[np.float64]:
        """(V, 3) true velocities, world ENU [m/s]."""
        return enu_from_ned(self.fleet.swarm.velocity_m_s)

    @property
    def targets_enu_m(self) -> NDArray[np.float64]:
        """(C, 3) true positions of the targets, world ENU [m]."""
        return np.array(self.targets.positions_enu_m(self.now_s)).reshape(-1, 3)

    @property
    def armed(self) -> NDArray[np.bool_]:
        """(V,) whether each vehicle is armed."""
        return np.array([vehicle.autopilot.armed for vehicle in self.fleet.vehicles])

    @property
    def counters(self) -> Counters:
        """What went wrong so far."""
        rows = [*(vehicle.codecs for vehicle in self.fleet.vehicles), *self.targets.codecs]
        codecs = [codec for row in rows for codec in row]
        ports = [port for row in self._ports for port in row]
        return Counters(
            bad_bytes=sum(codec.bad_bytes for codec in codecs),
            dropped=sum(port.dropped for port in ports),
            unsendable=sum(codec.unsendable for codec in codecs),
            send_errors=sum(port.errors for port in ports),
            slipped_s=0.0 if self._clock is None else self._clock.slipped_s,
            not_signed=sum(vehicle.signing.refused for vehicle in self.fleet.vehicles),
        )

    # -- time -----------------------------------------------------------------------------------------------------

    @property
    def now_s(self) -> float:
        """Simulated time, also before the start [s]."""
        return 0.0 if self._clock is None else self._clock.now_s()

    def pause(self) -> None:
        """Let time stand still: vehicles neither move nor say anything by themselves, but answer.

        Raises:
            RuntimeError: it was not started.
        """
        self._running_clock().pause()
        self._cancel_timers()

    def resume(self) -> None:
        """Let time go on.

        Raises:
            RuntimeError: it was not started.
        """
        self._running_clock().run()
        self._cancel_timers()
        self._schedule_tick()

    def step(self, seconds: float) -> None:
        """Let a paused simulator's time go on by so much, at once; all that is said meanwhile is sent.

        Raises:
            RuntimeError: it was not started, or is not paused.
            ValueError: it is no time that can be waited for.
        """
        clock = self._running_clock()
        if not 0.0 <= seconds <= LONGEST_STEP_S:
            raise ValueError(f"a step takes from 0 to {LONGEST_STEP_S:g} s, not {seconds:g}")
        if not clock.paused:
            raise RuntimeError("only a paused simulator can be stepped")
        end_s = clock.now_s() + seconds
        tick_s = self.fleet.physics.time.tick_s
        while (now_s := clock.now_s()) < end_s - DUE_SLACK_S:
            next_s = (math.floor(now_s / tick_s + 1e-6) + 1) * tick_s  # the same ticks as when time goes by itself
            if next_s > end_s + DUE_SLACK_S:
                clock.move(end_s - now_s)
                break
            clock.move(next_s - now_s)
            self._say_what_is_due()
        self._advance()

    def _running_clock(self) -> SimulatedClock:
        if self._clock is None or self._closed:
            raise RuntimeError("the simulator was not started, or is closed")
        return self._clock

    def _advance(self) -> float:
        """Bring the fleet to the present; give its time."""
        if self._clock is None:
            return 0.0
        clock = self._clock
        now_s = clock.now_s()
        late_s = now_s - self.fleet.time_s - self.fleet.physics.time.catch_up_s
        if late_s > 0.0 and clock.goes:
            clock.slip(late_s)
            now_s -= late_s
        self._send(self.fleet.advance(now_s), now_s)
        return now_s

    def _tick(self) -> None:
        assert self._loop is not None
        clock, tick_s = self._running_clock(), self.fleet.physics.time.tick_s
        number, late_s = self._number, self._loop.time() - self._due_s
        if not clock.goes:
            clock.move(tick_s)
        self._say_what_is_due()
        self._schedule_tick()
        if clock.goes:
            self.lateness.add(max(0.0, late_s), max(0, self._number - number - 1), tick_s / clock.speed)

    def _say_what_is_due(self) -> None:
        now_s = self._advance()
        if len(self.fleet.incidents.found) > self._written:
            self._write_truth()
        self._send(self.fleet.telemetry(now_s), now_s)
        first = len(self.fleet.vehicles)
        self._send([Sent(first + row, link, data) for row, link, data in self.targets.telemetry(now_s)], now_s)
        if self._impairments.next_s is not None:
            self._deliver(now_s)

    def _write_truth(self) -> None:
        """Write down what was seen; a disk that takes nothing more stops no vehicle."""
        self._written = len(self.fleet.incidents.found)
        if self.options.truth is not None:
            with suppress(OSError):
                write_truth(self.options.truth, self.fleet.incidents)

    def _schedule_tick(self) -> None:
        """The next tick at an absolute deadline: late ticks are left out, never queued."""
        clock, tick_s = self._running_clock(), self.fleet.physics.time.tick_s
        assert self._loop is not None
        if clock.paused:
            return
        if not clock.goes:
            self._timer = self._loop.call_soon(self._tick)
            return
        self._number = math.floor(clock.now_s() / tick_s + 1e-6) + 1  # 1e-6: just on time is not late
        self._due_s = clock.loop_s(self._number * tick_s)
        self._timer = self._loop.call_at(self._due_s, self._tick)

    def _cancel_timers(self) -> None:
        for timer in (self._timer, self._delivery):
            if timer is not None:
                timer.cancel()
        self._timer = self._delivery = None

    # -- datagrams ------------------------------------------------------------------------------------------------

    def _controlled(self, vehicle: int, link: int, data: bytes) -> bool:
        """Whether a datagram is a command about time itself, see `TIME_COMMAND`; it is done and acknowledged."""
        if not self.options.lockstep or first_message_id(data) != layout("COMMAND_LONG").id:
            return False
        own = self.fleet.vehicles[vehicle]
        found = [m for m in own.codecs[link].decode(data) if m.fields.get("command") == TIME_COMMAND]
        if not found:
            return False
        action, seconds = found[0].fields["param1"], found[0].fields["param2"]
        result = CommandResult.ACCEPTED
        if action == TimeAction.RUN:
            self.resume()
        elif action == TimeAction.PAUSE:
            self.pause()
        elif action == TimeAction.STEP and self._running_clock().paused and 0.0 <= seconds <= LONGEST_STEP_S:
            self.step(seconds)
        else:
            result = CommandResult.DENIED
        fields: Fields = {
            "command": TIME_COMMAND,
            "result": int(result),
            "result_param2": round(self.now_s * 1e3),
            "target_system": found[0].system,
            "target_component": found[0].component,
        }
        acknowledgement = own.codecs[link].encode("COMMAND_ACK", fields, own.autopilot.system_id)
        self._ports[vehicle][link].send(acknowledgement)  # past all impairments: time itself hangs on it
        return True

    def _send(self, sent: list[Sent], now_s: float) -> None:
        impaired = False
        for vehicle, link, data in sent:
            if self._impairments.concern(vehicle, FROM_VEHICLE):
                self._impairments.send(vehicle, link, FROM_VEHICLE, data, now_s)
                impaired = True
            else:
                self._ports[vehicle][link].send(data)
        if impaired:
            self._deliver(now_s)

    def _deliver(self, now_s: float) -> None:
        """Hand over the datagrams that have been long enough on their way, and come back for the next."""
        for due_s, _, vehicle, link, direction, data in self._impairments.arrived(now_s):
            if direction == FROM_VEHICLE:
                self._ports[vehicle][link].send(data)
            else:
                self._send(self.fleet.receive(vehicle, link, data, max(due_s, self.fleet.time_s)), now_s)
        next_s, clock = self._impairments.next_s, self._clock
        if self._delivery is not None:
            self._delivery.cancel()
            self._delivery = None
        if next_s is not None and clock is not None and clock.goes:  # else the ticks do it
            assert self._loop is not None
            self._delivery = self._loop.call_at(clock.loop_s(next_s), self._deliver_later)

    def _deliver_later(self) -> None:
        self._delivery = None
        self._deliver(self._advance())


async def _bind(loop: asyncio.AbstractEventLoop, port: _Port, number: int, remotes: tuple[Address, ...]) -> None:
    """Give a port its socket; where any will do, none of those that others are to be heard at.

    Raises:
        PortUnavailable: the system refuses.
    """
    refused: list[asyncio.BaseTransport] = []  # kept open, so that the system gives another one
    try:
        while True:
            transport, _ = await loop.create_datagram_endpoint(lambda: port, local_addr=(HOST, number))
            if number or (HOST, port.number) not in remotes:
                return
            refused.append(transport)
    except OSError as error:
        raise PortUnavailable(number, error.strerror or str(error)) from error
    except OverflowError as error:
        raise PortUnavailable(number, "there is no such port") from error
    finally:
        for each in refused:
            each.close()
