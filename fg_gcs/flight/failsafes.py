"""What is set in vehicles for a flight: what they do when we fall silent, and how hard they follow.

It is set before arming, watched in flight, and put back when each vehicle is seen disarmed.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from typing import Final

from fg_gcs.core.arrays import Array
from fg_gcs.flight.fleet import Fleet
from fg_gcs.flight.journal import Journal
from fg_gcs.flight.policy import Fault, FaultKind
from fg_gcs.flight.preparation import AT_ONCE
from fg_gcs.link.clock import ticks
from fg_gcs.plan.by_themselves import ByThemselves
from fg_gcs.record.write.kept_parameters import Kept, KeptParameters
from fg_gcs.wire.address import VehicleAddress, vehicles_named
from fg_gcs.wire.autopilots import FailsafeParameter
from fg_gcs.wire.commands import write_parameter
from fg_gcs.wire.params import same
from fg_gcs.wire.reading import ReadParameters, Wanted, read
from fg_gcs.wire.vehicle import Vehicle

JERK: Final = "jerk_m_s3"  # the quantity of a limit
LOOKS_S: Final = 2.0  # between two looks at what is set: noticed within 5 s on a link that loses a third
HEARD_S: Final = 1.5  # a vehicle that was not heard for longer cannot be asked


class Failsafes:
    """The failsafe parameters of a fleet.

    Args:
        fleet: the vehicles, their parameters read.
        journal: where to tell of it.
        kept: where users' own values are kept on disk; None: nowhere.
        jerk_m_s3: the limit for those that shape setpoints by one of their own [m/s^3]; None: each keeps its own.

    Attributes:
        turned_s: the loop's time of the newest sign of life of `watch` [s].
        returns_m: at which heights the vehicles return when they hear nothing any more, shape (V,) [m; above the
            ground]; None: they land where they are.
    """

    def __init__(
        self, fleet: Fleet, journal: Journal, kept: KeptParameters | None, jerk_m_s3: float | None = None
    ) -> None:
        self.turned_s = -math.inf
        self._fleet = fleet
        self._journal = journal
        self._kept = kept
        self._found: dict[Vehicle, dict[str, float]] = {}  # users' own values of what is changed
        self._set: dict[Vehicle, dict[str, float]] = {}  # what they are set to
        self._files: dict[Vehicle, Kept] = {}
        self._crashed: dict[Vehicle, Kept] = {}  # what runs that crashed have kept of them, until it is kept anew
        self._others: set[Vehicle] = set()  # of which something is kept that is of other hardware
        self._told: set[tuple[VehicleAddress, str, float]] = set()
        self.returns_m: Array | None = None
        self._waits_s = 0.0
        self._runs_on_s: float | None = None
        self._jerk_m_s3 = jerk_m_s3

    async def set(self, alone: ByThemselves | None = None, runs_on_s: float | None = None) -> None:
        """Change those failsafes that are unsafe for a swarm, as `prepare` has read them; say what was found and set.

        It may be called again with another choice: what was found first is the user's own. A value that an earlier run
        has set, and did not put back because it crashed, is not.

        Args:
            alone: how the swarm comes down by itself; None: every vehicle lands where it is.
            runs_on_s: how long vehicles that run on without setpoints may do so; None: as long as any flight lets them.

        Raises:
            VehicleError: a vehicle keeps an unsafe value; names vehicle and parameter.
        """
        self._runs_on_s = runs_on_s
        if alone is not None and alone.heights_m is not None:
            await self._choose_returns(alone.heights_m, alone.waits_s)
        left = await self._left()
        for row, vehicle in enumerate(self._fleet.vehicles):
            own = {**vehicle.params, **left.get(vehicle, {}), **self._found.get(vehicle, {})}
            wanted = {name: own[name] for name in left.get(vehicle, {})} | self._wanted(row, vehicle, own)
            for name, value in wanted.items():
                if name in vehicle.params and not (same(vehicle.params[name], value) and same(own[name], value)):
                    self._found.setdefault(vehicle, {}).setdefault(name, own[name])
                    self._set.setdefault(vehicle, {})[name] = value
        self._keep()  # before anything is changed: whatever happens, what was found can be looked up
        await self._fleet.ask(
            list(self._set),
            lambda vehicle: [write_parameter(name, value) for name, value in self._set[vehicle].items()],
            AT_ONCE,
        )
        self._report()

    async def _choose_returns(self, heights_m: Array, waits_s: float) -> None:
        """Let all return at these heights, shape (V,) [m], if all of them can; read what is changed for that.

        Raises:
            VehicleError: a vehicle does not tell a parameter.
        """
        vehicles = self._fleet.vehicles
        await self._fleet.ask(
            vehicles,
            lambda vehicle: [
                ReadParameters(tuple(Wanted(tuple(one.names), needed=False) for one in vehicle.profile.returns))
            ],
        )
        unable = [
            vehicle.address
            for vehicle in vehicles
            if any(one.needed and one.name_in(vehicle.params) is None for one in vehicle.profile.returns)
        ]
        if unable:
            text = f"{vehicles_named(unable)} cannot return at a height of its own"
            self._journal.event("warning", f"{text}, so all land where they are when this program is gone")
        else:
            self.returns_m, self._waits_s = heights_m, waits_s

    def _wanted(self, row: int, vehicle: Vehicle, own: Mapping[str, float]) -> dict[str, float]:
        """Return what parameters of a vehicle are to be for this flight, by the user's own values."""
        unsafe = (one for one in vehicle.profile.failsafes if not one.is_safe(own.get(one.name, math.nan)))
        wanted = {one.name: one.wanted for one in unsafe if one.wanted is not None}
        wanted |= self._jerk(vehicle)
        timeout = vehicle.profile.stream_timeout[0]
        if self._runs_on_s is not None and vehicle.profile.lost_link.runs_on:
            wanted[timeout] = min(wanted.get(timeout, own.get(timeout, math.inf)), self._runs_on_s)
        if self.returns_m is not None:
            for one in vehicle.profile.returns:
                name = one.name_in(vehicle.params)
                if name is not None:
                    wanted[name] = one.value_for(name, float(self.returns_m[row]), self._waits_s)
        return wanted

    def _jerk(self, vehicle: Vehicle) -> dict[str, float]:
        """Return the jerk limit that a vehicle gets, by the name that it has there; nothing if it keeps its own."""
        if self._jerk_m_s3 is None:
            return {}
        limits = (limit.names for limit in vehicle.profile.limits if limit.quantity == JERK)
        return {
            name: self._jerk_m_s3 / scale for names in limits for name, scale in names.items() if name in vehicle.params
        }

    async def watch(self, report: Callable[[Fault], None]) -> None:
        """Read again what was set, for ever, and set it again where it has changed: run it as a task.

        Args:
            report: called with a fault when a parameter has another value.
        """
        router = self._fleet.router
        async for _ in ticks(self._journal.time(), LOOKS_S):
            self.turned_s = self._journal.time()
            for vehicle, values in self._set.items():
                for name, value in values.items():
                    now = vehicle.params[name]
                    if not same(now, value):
                        self._tell(vehicle, name, (value, now), report)
                        for message in write_parameter(name, value).build(vehicle):
                            router.send_message(vehicle.address, message)
                    router.send_message(vehicle.address, read(vehicle, name))

    async def put_back(self) -> None:
        """Restore what was found on the vehicles that are heard and seen disarmed: in the air each keeps its failsafe.

        Raises:
            VehicleError: a vehicle does not take its old value back.
        """
        now_s = self._journal.time()
        down = [v for v in self._found if not v.armed and now_s - v.heard_at_s < HEARD_S]
        for vehicle in down:
            self._set.pop(vehicle, None)  # or the watch, which still runs, would set it again
        try:
            await self._fleet.ask(
                down,
                lambda vehicle: [write_parameter(name, value) for name, value in self._found[vehicle].items()],
                AT_ONCE,
            )
        finally:
            for vehicle in down:
                if self._kept is not None and vehicle in self._files and self.has_its_own(vehicle):
                    self._kept.forget(self._files[vehicle])

    def has_its_own(self, vehicle: Vehicle) -> bool:
        """Say whether a vehicle has its user's own values, as last heard."""
        found = self._found.get(vehicle, {})
        return all(same(vehicle.params[name], value) for name, value in found.items())

    def _tell(self, vehicle: Vehicle, name: str, values: tuple[float, float], report: Callable[[Fault], None]) -> None:
        """Tell once of a parameter that has changed from the value that was set to another one."""
        was, now = values
        if (vehicle.address, name, now) in self._told:
            return
        self._told.add((vehicle.address, name, now))
        text = f"{name} of vehicle {vehicle.address} has changed from {was:g} to {now:g}; it is set again"
        self._journal.event("fault", text, fault=FaultKind.PARAMETER.value, vehicles=[vehicle.address.label], value=now)
        report(Fault(FaultKind.PARAMETER, (vehicle.address,), text, self._journal.time(), now))

    async def _left(self) -> dict[Vehicle, dict[str, float]]:
        """Return vehicles' own values that runs which did not end have changed and left so; read and told once.

        Raises:
            VehicleError: a vehicle does not tell one of them.
        """
        kept = self._kept_of_runs_that_crashed()
        self._crashed |= kept
        await self._fleet.ask(
            kept,
            lambda vehicle: [ReadParameters(tuple(Wanted((name,), needed=False) for name in kept[vehicle].set))],
        )
        found: dict[Vehicle, dict[str, float]] = {}
        for vehicle, one in kept.items():
            for name, value in one.set.items():
                if name in one.found and same(vehicle.params.get(name, math.nan), value):
                    found.setdefault(vehicle, {})[name] = one.found[name]
                    text = f"{name} = {value:g} is left by a run that crashed; it was {one.found[name]:g}"
                    self._journal.event("failsafe", f"vehicle {vehicle.address}: {text}")
        return found

    def _kept_of_runs_that_crashed(self) -> dict[Vehicle, Kept]:
        """Return what is kept of these vehicles: by where they are heard, unless that is known to be of other hardware.

        Hardware with the same id that was heard elsewhere, where none of these is, is taken to have moved.
        """
        kept: dict[Vehicle, Kept] = {}
        left, places = [] if self._kept is None else self._kept.left(), dict(self._places())
        moved = [one for one in left if one.uid and self._place(one) not in places.values()]
        for vehicle, place in places.items():
            here = [one for one in left if self._place(one) == place]
            own = [one for one in here if one.may_be(vehicle.uid)]
            own = own or [one for one in moved if (one.uid, one.system_id) == (vehicle.uid, vehicle.system_id)]
            if own:
                kept[vehicle] = max(own, key=lambda one: one.uid)  # rather what names its hardware
            elif here and vehicle not in self._others:
                self._others.add(vehicle)
                text = f"what a run that crashed has kept of vehicle {vehicle.address} is of other hardware"
                self._journal.event("warning", f"{text} ({here[0].uid}, not {vehicle.uid}): left alone")
        return kept

    def _places(self) -> Iterator[tuple[Vehicle, tuple[str, int, str]]]:
        """Yield each vehicle with what tells it from others in what is kept."""
        for vehicle in self._fleet.vehicles:
            yield vehicle, (*vehicle.address, self._fleet.router.endpoint_of(vehicle.address))

    @staticmethod
    def _place(kept: Kept) -> tuple[str, int, str]:
        return kept.network, kept.system_id, kept.endpoint

    def _keep(self) -> None:
        """Let the record have every parameter that was read, as found, and those that are set; and keep the users' own.

        A disk that does not take them is told; the flight goes on, because the record has them, too.
        """
        rows = []
        for vehicle in self._fleet.vehicles:
            own, to_set = self._found.get(vehicle, {}), self._set.get(vehicle, {})
            address, found = vehicle.address._asdict(), {**vehicle.params, **own}
            what = {"autopilot": vehicle.profile.name, "uid": vehicle.uid, "found": found, "set": to_set}
            rows.append({**address, **what})
            if self._kept is None or not to_set:
                continue
            endpoint, run = self._fleet.router.endpoint_of(vehicle.address), self._journal.recorder.folder
            kept = Kept(
                vehicle.address.network,
                vehicle.address.system_id,
                vehicle.uid,
                endpoint,
                vehicle.profile.name,
                own,
                to_set,
                str(run.absolute()),
                self._kept.lock,
            )
            try:
                self._kept.keep(kept)
                self._files[vehicle] = kept
                crashed = self._crashed.pop(vehicle, kept)
                if crashed.name != kept.name:  # its hardware was not known then, or is not now
                    self._kept.forget(crashed)
            except OSError as error:
                names = ", ".join(f"{name} = {value:g}" for name, value in to_set.items())
                self._journal.event(
                    "warning",
                    f"{self._kept.folder}: {error.strerror or error}: a crash would leave {names}",
                )
        self._journal.recorder.parameters(rows)

    def _report(self) -> None:
        groups: dict[tuple[str, float, float | None, str], list[VehicleAddress]] = {}
        for vehicle in self._fleet.vehicles:
            returns = () if self.returns_m is None else vehicle.profile.returns
            told = {name for one in returns for name in one.names}  # of all of them together, in a sentence
            for failsafe in vehicle.profile.failsafes:
                if failsafe.name in vehicle.params and failsafe.name not in told:
                    groups.setdefault(self._line(vehicle, failsafe), []).append(vehicle.address)
            for name, value in self._jerk(vehicle).items():
                own = self._found.get(vehicle, {}).get(name, value)
                line = name, own, None if same(own, value) else value, "how hard it follows, as the mission has it"
                groups.setdefault(line, []).append(vehicle.address)
        for (name, found, to, reason), addresses in groups.items():
            change = "" if to is None else f", set to {to:g} for this flight"
            kind = "found" if to is None else "failsafe"
            self._journal.event(kind, f"{name} = {found:g}{change} on {vehicles_named(addresses)} ({reason})")

    def _line(self, vehicle: Vehicle, failsafe: FailsafeParameter) -> tuple[str, float, float | None, str]:
        own = self._found.get(vehicle, {})
        now = vehicle.params[failsafe.name]
        changed = failsafe.name in own
        return failsafe.name, own.get(failsafe.name, now), now if changed else None, failsafe.reason

    def told_at_the_end(self) -> list[str]:
        """Return lines that say where vehicles are, whether they are armed, and whose failsafes they have."""
        groups: dict[str, list[VehicleAddress]] = {}
        now_s = self._journal.time()
        for vehicle in self._fleet.vehicles:
            heard = now_s - vehicle.heard_at_s < HEARD_S
            where = "in the air" if vehicle.airborne else "on the ground"
            state = f"{where}, {'armed' if vehicle.armed else 'disarmed'}" if heard else "not heard any more"
            own = "with its own failsafe" if self.has_its_own(vehicle) else "with the failsafe of this flight"
            groups.setdefault(f"{state}, {own}", []).append(vehicle.address)
        return [f"{vehicles_named(addresses)}: {text}" for text, addresses in groups.items()]
