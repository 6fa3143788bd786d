"""The watch: looks at the whole fleet many times a second, and reports every fault once."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from types import MappingProxyType
from typing import Final

import numpy as np

from fg_gcs.flight.context import Context
from fg_gcs.flight.descents import Descents
from fg_gcs.flight.origins import OriginWatch
from fg_gcs.flight.policy import ROWS, Care, Fault, FaultKind
from fg_gcs.flight.safety import SPARE_S, Bounds, Finding, Picture, asked_s, delay_of, faults, findings
from fg_gcs.flight.streamer import STALL_S
from fg_gcs.link.clock import ticks
from fg_gcs.wire.address import VehicleAddress, vehicles_named
from fg_gcs.wire.commands import set_mode
from fg_gcs.wire.dialogue import Dialogue, State
from fg_gcs.wire.phases import Phase

WATCH_S: Final = 0.05  # at 10 m/s half a metre of way
FOLLOWS_S: Final = 1.0  # whoever follows setpoints again by itself does, and says so, within that
CALLED_S: Final = 3.0  # and whoever is called back does
CONFIRMED_S: Final = 0.3  # a course that is left for so long is left
FORGETS_S: Final = (
    4.0  # time constant of forgetting the greatest speed vehicles were told: PX4 overshoots a stop for 10 s
)

_ALL: Final = frozenset(FaultKind)
WATCHED: Final[Mapping[str, frozenset[FaultKind]]] = MappingProxyType(
    {  # on the way up all are still below the floor and not where they are to be; who disarms there is told by arming
        "take-off": _ALL
        - {FaultKind.FENCE, FaultKind.DISARMED, FaultKind.OFF_COURSE, FaultKind.DEAF}
        - {FaultKind.UNANSWERED},  # it is only asked often enough from here on
        **dict.fromkeys(("gather", "approach", "hold", "home", "spread"), _ALL),
    }
)


class Watch:
    """Looks for faults while plans are flown; run it as a task.

    Args:
        context: the flight.
        descents: bring down who is to land.
        bounds: from when on something is a fault.
        report: called with every fault once.

    Attributes:
        turned_s: the loop's time of the newest sign of life [s].
    """

    def __init__(self, context: Context, descents: Descents, bounds: Bounds, report: Callable[[Fault], None]) -> None:
        self.turned_s = -math.inf
        self._context, self._descents = context, descents
        self._bounds = bounds
        self._report = report
        self._known: set[tuple[FaultKind, tuple[VehicleAddress, ...]]] = set()
        self._off_course_s: dict[VehicleAddress, float] = {}  # since when
        self._asked_s = -math.inf
        self._told_speed_m_s = np.zeros(len(context.fleet.vehicles))
        self._origins = OriginWatch(context.fleet.vehicles, context.fleet.states)
        self._called: dict[int, Dialogue] = {}  # back after this program stood still, by their rows
        self._time = context.journal.time

    async def run(self) -> None:
        """Look, for ever."""
        blind_until_s = -math.inf
        async for _, late_s in ticks(self._time(), WATCH_S):
            now_s = self.turned_s = self._time()
            if late_s > STALL_S:  # this program stood still: what the vehicles said meanwhile has yet to be read
                self._context.streamer.stood_still(late_s)
                delays_s = (delay_of(vehicle) for vehicle in self._context.fleet.vehicles)
                blind_until_s = now_s + FOLLOWS_S + 2.0 * max(delays_s)
            elif now_s >= blind_until_s > -math.inf:
                blind_until_s = now_s + 0.5 * WATCH_S if self._call_back(now_s) else -math.inf
            moved = self._join_origins()
            watched = WATCHED.get(self._context.journal.stage, frozenset())
            if watched:
                self._ask(now_s)
                if now_s >= blind_until_s:
                    self._look(watched, now_s, moved)
            self._attend()

    def _call_back(self, now_s: float) -> bool:
        """Take those back that follow setpoints again after this program stood still, and call back those that hover.

        Whoever does not come is given up, as is who lands or returns already. Until then nothing is looked at.

        Returns:
            Whether somebody is still called.
        """
        vehicles = self._context.fleet.vehicles
        changed = [row for row in self._watched_rows() if vehicles[row].phase in (Phase.TAKEN, Phase.LANDED)]
        away = [row for row in changed if not vehicles[row].take_back(now_s)]
        for row in away:
            profile = vehicles[row].profile
            if row not in self._called and vehicles[row].mode in profile.hovering_modes:
                request = replace(set_mode(profile.streaming_mode), deadline_s=CALLED_S)
                self._called[row] = Dialogue(vehicles[row], request)
        for row, dialogue in self._called.items():
            for message in dialogue.step(now_s):
                self._context.fleet.router.send_message(vehicles[row].address, message)
        if any(row in away and dialogue.state is State.PENDING for row, dialogue in self._called.items()):
            return True
        self._called.clear()
        if away:
            self._leave(away)
        return False

    def _leave(self, rows: list[int]) -> None:
        """Give up those that come down by themselves.

        Whoever returns, each at a height of its own, goes on: what comes of that was computed before arming.
        """
        context, vehicles = self._context, self._context.fleet.vehicles
        returning = [row for row in rows if context.custody.returns(row)]
        for row in rows:
            context.custody.take(row, Care.LEAVE if row in returning else Care.LAND)
        context.streamer.release(rows)
        self._descents.begin(rows, returning)
        subject, be = vehicles_named(vehicles[row].address for row in rows), "is" if len(rows) == 1 else "are"
        text = f"{subject} {be} on the way down, or down, by their own failsafes, as nothing was sent meanwhile"
        context.journal.event("notice", text)

    def _watched_rows(self) -> list[int]:
        """Return the rows of the vehicles that fly for us."""
        custody = self._context.custody
        rows = (row for row in sorted(custody.asked) if custody.counted_on(row))
        return [row for row in rows if not self._descents.is_begun(row)]

    def _join_origins(self) -> list[Finding]:
        """Join frames that have moved to the mission's anew, and return them; also that of one that started again."""
        fleet, watched = self._context.fleet, self._watched_rows()
        moved = self._origins.moved_enu_m()
        for row, by_enu_m in moved.items():
            fleet.move_origin(row, by_enu_m)
        return [
            Finding(FaultKind.ORIGIN, (fleet.vehicles[row].address,), size=float(np.linalg.norm(by_enu_m)))
            for row, by_enu_m in moved.items()
            if row in watched
        ]

    def _look(self, watched: frozenset[FaultKind], now_s: float, moved: list[Finding]) -> None:
        context = self._context
        rows = self._watched_rows()
        picture = self._picture(rows, now_s)
        found = self._confirmed(moved + findings(picture, context.task.rules, self._bounds), now_s)
        found = [one for one in found if one.kind in watched]
        new = [one for one in found if (one.kind, one.vehicles) not in self._known]
        self._known.update((one.kind, one.vehicles) for one in new)
        self._take_back(found, rows)
        for fault in faults(new, context.task.rules, now_s):
            context.journal.event(
                "fault",
                fault.text,
                fault=fault.kind.value,
                vehicles=[vehicle.label for vehicle in fault.vehicles],
                value=fault.value if math.isfinite(fault.value) else None,
            )
            self._take(fault, picture)
            self._report(fault)

    def _ask(self, now_s: float) -> None:
        """Ask vehicles for their time, as often as is due: by their answers they are known to hear us."""
        fleet = self._context.fleet
        if now_s - self._asked_s >= asked_s(len(fleet.vehicles)) - 0.5 * WATCH_S:
            self._asked_s = now_s
            fleet.router.ask_for_time(fleet.vehicles[row].address for row in self._watched_rows())

    def _picture(self, rows: list[int], now_s: float) -> Picture:
        fleet = self._context.fleet
        told, velocity = self._context.streamer.gate.told(now_s)
        self._told_speed_m_s *= math.exp(-WATCH_S / FORGETS_S)
        self._told_speed_m_s = np.fmax(self._told_speed_m_s, np.linalg.norm(velocity, axis=1))  # NaN: told nothing
        return Picture(fleet.vehicles, rows, fleet.located(now_s), told, self._told_speed_m_s, now_s)

    def _confirmed(self, found: list[Finding], now_s: float) -> list[Finding]:
        """Return the findings of which courses count that were left for a while, and those that were left for good."""
        off = {one.vehicles[0]: one for one in found if one.kind is FaultKind.OFF_COURSE}
        self._off_course_s = {address: self._off_course_s.get(address, now_s) for address in off}
        kept = [one for one in found if one.kind is not FaultKind.OFF_COURSE]
        for address, one in off.items():
            lasts_s = now_s - self._off_course_s[address]
            vehicle = self._context.fleet.vehicles[self._context.fleet.row_of[address]]
            if lasts_s > vehicle.stream_timeout_s + SPARE_S:
                kept.append(one._replace(kind=FaultKind.DEAF))
            elif lasts_s > CONFIRMED_S:
                kept.append(one)
        return kept

    def _take(self, fault: Fault, picture: Picture) -> None:
        """Change the care of the vehicles that a fault is about."""
        context, care = self._context, ROWS[fault.kind].care
        if care is Care.FLY:
            return
        rows = [context.fleet.row_of[address] for address in fault.vehicles]
        for row in rows:
            context.custody.take(row, care, picture.told_enu_m[row])
        if care is Care.LEAVE:
            context.streamer.release(rows)
        elif fault.kind is FaultKind.OWN_FAILSAFE:
            vehicles = context.fleet.vehicles  # what comes down already must not follow a stream again, as PX4 does
            self._descents.begin(row for row in rows if vehicles[row].mode == vehicles[row].profile.land_mode)

    def _take_back(self, found: list[Finding], rows: list[int]) -> None:
        """Let those fly on that are heard again, where they should be."""
        custody, fleet = self._context.custody, self._context.fleet
        waited = {address for one in found if ROWS[one.kind].care is not Care.FLY for address in one.vehicles}
        back = [row for row in rows if custody.care(row) is Care.TELL and fleet.vehicles[row].address not in waited]
        for row in back:
            custody.take(row, Care.FLY)
        addresses = [fleet.vehicles[row].address for row in back]
        if addresses:
            be = "is" if len(addresses) == 1 else "are"
            self._context.journal.event("notice", f"{vehicles_named(addresses)} {be} there again")
            gone = {(kind, (address,)) for kind in FaultKind if ROWS[kind].care is Care.TELL for address in addresses}
            self._known -= gone

    def _attend(self) -> None:
        """Command those to land that were given up, as soon as nobody is below them."""
        custody, rules = self._context.custody, self._context.task.rules
        for row, care in custody.given_up():
            if care is not Care.LAND or self._descents.is_begun(row):
                continue
            clear = row in custody.avoided and not custody.is_below(row, custody.flying(), rules.separation_m)
            if clear or not custody.flying():
                self._descents.begin([row])
