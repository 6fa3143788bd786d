"""Which vehicles a flight counts on, and where those may be that it does not: what later plans keep clear."""

from __future__ import annotations

from collections.abc import Callable, Iterable

import numpy as np

from fg_gcs.core.arrays import Array
from fg_gcs.flight.fleet import Fleet
from fg_gcs.flight.policy import Care
from fg_gcs.plan.keep_clear import Column
from fg_gcs.wire.vehicle import Vehicle

NEAR_M = 0.5  # how far a vehicle that is heard may be from where it says that it is, or drift while it comes down
UNHEARD_M = 1.0  # likewise of one that is not heard
RISES_M = 1.0  # how much higher than where it was last it may be
BRAKES_M_S2 = 2.0  # what a vehicle brakes by when its own time-out has passed: ArduCopter's default
RETURN_M = 30.0  # height at which PX4 returns when it is far; ArduCopter does at 15 m
ON_GROUND_M = 0.5  # the height that a vehicle on the ground takes up
BLOCKS_M = 2.0  # a vehicle so near to another one's pad is in its way
HOVERS_S = 6.0  # a vehicle that has heard nothing for so long may soon begin to return
FRESH_S = 1.0  # a position older than that is where a vehicle was


class Custody:
    """Care of every vehicle of a fleet.

    Args:
        fleet: with its frames.
        pads_enu_m: where the vehicles stood before the flight, shape (V, 3) [m].
        time: the flight's clock [s].

    Attributes:
        asked: rows of vehicles that were asked to arm: they are ours to bring down.
        avoided: rows of those that were given up and that the present plan keeps clear of.
        returns_m: at which heights vehicles return that hear nothing any more, shape (V,) [m]; None: they land.
        kept_clear: where those may be, as the present plan has it, by their rows.
    """

    def __init__(self, fleet: Fleet, pads_enu_m: Array, time: Callable[[], float]) -> None:
        self.asked: set[int] = set()
        self.avoided: set[int] = set()
        self.returns_m: Array | None = None
        self.kept_clear: dict[int, list[Column]] = {}
        self._fleet = fleet
        self._pads_enu_m = pads_enu_m
        self._time = time
        self._care: dict[int, Care] = {}  # of those that do not fly with the others
        self._told_enu_m: dict[int, Array] = {}  # where those were told to be

    def care(self, row: int) -> Care:
        """Return what becomes of a vehicle."""
        return self._care.get(row, Care.FLY)

    def take(self, row: int, care: Care, told_enu_m: Array | None = None) -> None:
        """Change a vehicle's care; nothing gives one back that was given up.

        Args:
            row: of the fleet.
            care: what becomes of it.
            told_enu_m: where it is told to be now, shape (3,), if anywhere [m].
        """
        if care is Care.FLY and self.care(row) is Care.TELL:
            del self._care[row]
        elif care is not Care.FLY and self.care(row) in (Care.FLY, Care.TELL):
            self._care[row] = care
            if told_enu_m is not None and np.isfinite(told_enu_m).all():
                self._told_enu_m[row] = told_enu_m
        elif care is Care.LAND:  # somebody else had it
            self._care[row] = care

    def rests(self, row: int, told_enu_m: Array) -> None:
        """Say where a vehicle that was given up is told to rest, shape (3,) [m]: it is there if it hears."""
        self._told_enu_m[row] = told_enu_m

    @property
    def waits(self) -> bool:
        """Whether the others wait for a vehicle that may hear."""
        return Care.TELL in self._care.values()

    @property
    def lost(self) -> tuple[int, ...]:
        """Rows of the vehicles that were given up, ascending."""
        return tuple(sorted(row for row, care in self._care.items() if care in (Care.LAND, Care.LEAVE)))

    def flying(self) -> list[int]:
        """Rows of the armed vehicles that fly for us."""
        vehicles = self._fleet.vehicles
        return [row for row, vehicle in enumerate(vehicles) if vehicle.armed and self.counted_on(row)]

    def counted_on(self, row: int) -> bool:
        """Say whether a vehicle flies with the others, or is waited for."""
        return self.care(row) in (Care.FLY, Care.TELL)

    def given_up(self) -> Iterable[tuple[int, Care]]:
        """Rows of the vehicles that were given up, and what becomes of them."""
        return ((row, self._care[row]) for row in self.lost)

    def columns(self) -> list[Column]:
        """Return where those may be by now that were given up, down to the ground: what is planned now avoids it."""
        self.avoided.update(self.lost)
        self.kept_clear = {row: [self.column(row), *self._as_told(row), *self._returns(row)] for row in self.lost}
        return [column for columns in self.kept_clear.values() for column in columns]

    def _returns(self, row: int) -> list[Column]:
        """Return where a vehicle climbs and comes down that hears nothing any more, unless it is seen to land.

        It hovers for ten seconds first, so that nobody need leave the air above it at once. In between it flies at a
        height of its own; by then the others are far below, or away.
        """
        vehicle = self._fleet.vehicles[row]
        heard = self._time() - vehicle.position_at_s < FRESH_S
        on_its_way = self.care(row) is Care.LAND and not (heard and vehicle.mode == vehicle.profile.land_mode)
        if self.returns_m is None or not on_its_way or (heard and not vehicle.armed):
            return []
        climbs = _travels(vehicle) if heard else self._time() - vehicle.heard_at_s > HOVERS_S
        place, height_m = self._fleet.positions_enu_m()[row], self.returns_m[row] + RISES_M
        pad = self._pads_enu_m[row]
        if not np.isfinite(place).all():
            place = pad
        above = [_around(place, place, height_m, UNHEARD_M)] if climbs else []
        return [*above, _around(pad, pad, height_m, NEAR_M)]

    def column(self, row: int) -> Column:
        """Return where a vehicle may be by now that was given up."""
        vehicle, now_s = self._fleet.vehicles[row], self._time()
        place = self._fleet.positions_enu_m()[row]
        if not np.isfinite(place).all():  # it never told; it has not left its pad as far as known
            place = self._pads_enu_m[row]
        heard = now_s - vehicle.position_at_s < FRESH_S
        if heard and not vehicle.armed:  # whose heights may count from where it started again up in the air
            return _around(place, place, max(place[2], 0.0) + ON_GROUND_M, NEAR_M)
        if heard and self.care(row) is Care.LEAVE and _travels(vehicle):
            return _around(place, self._pads_enu_m[row], max(place[2], RETURN_M) + RISES_M, UNHEARD_M)
        if heard:
            return _around(place, place, place[2] + RISES_M, NEAR_M)._replace(place_enu_m=_point(place))
        return self._unheard(row, vehicle, place)

    def _unheard(self, row: int, vehicle: Vehicle, place: Array) -> Column:
        """Where it was last, and where that velocity may have led it."""
        north, east, down = vehicle.velocity_ned_m_s or (0.0, 0.0, 0.0)
        velocity = np.array([east, north, -down])
        speed = float(np.linalg.norm(velocity))
        on_s = vehicle.stream_timeout_s + 0.5 * speed / BRAKES_M_S2
        away = place + on_s * velocity
        column = _around(place, away, max(place[2], away[2]) + RISES_M, UNHEARD_M)
        return column._replace(place_enu_m=_point(self._told_enu_m.get(row, place)))

    def _as_told(self, row: int) -> list[Column]:
        """Where it is if it is not heard, but has heard us: on the way to where it was told to be."""
        told, place = self._told_enu_m.get(row), self._fleet.positions_enu_m()[row]
        heard = self._time() - self._fleet.vehicles[row].position_at_s < FRESH_S
        if heard or told is None or not np.isfinite(place).all():
            return []
        return [_around(place, told, max(place[2], told[2]) + RISES_M, UNHEARD_M)]

    def returns(self, row: int) -> bool:
        """Say whether a vehicle returns at a height of its own, as is set for this flight."""
        vehicle = self._fleet.vehicles[row]
        return self.returns_m is not None and vehicle.armed and _travels(vehicle)

    def is_blocked(self, row: int) -> bool:
        """Say whether a mode leads a vehicle to its pad, and another one of ours is there."""
        if not _travels(self._fleet.vehicles[row]):
            return False
        away = np.linalg.norm(self._fleet.positions_enu_m()[:, :2] - self._pads_enu_m[row, :2], axis=1)
        away[row] = np.inf
        return bool((away < BLOCKS_M).any())

    def is_below(self, row: int, others: Iterable[int], clear_m: float) -> bool:
        """Say whether one of some vehicles is where another may come down, nearer than a distance [m]."""
        column = self.column(row)
        places = self._fleet.positions_enu_m()[list(others)]
        start, end = np.array(column.start_enu_m), np.array(column.end_enu_m)
        return any(
            place[2] < column.top_m and _from_line(place[:2], start, end) < column.radius_m + clear_m
            for place in places
            if np.isfinite(place).all()
        )


def _travels(vehicle: Vehicle) -> bool:
    """Say whether a mode leads a vehicle elsewhere: any that neither lands nor hovers."""
    profile = vehicle.profile
    return vehicle.mode not in {profile.land_mode, profile.streaming_mode, *profile.hovering_modes}


def _around(start: Array, end: Array, top_m: float, radius_m: float) -> Column:
    return Column((float(start[0]), float(start[1])), (float(end[0]), float(end[1])), float(top_m), float(radius_m))


def _point(place: Array) -> tuple[float, float, float]:
    return float(place[0]), float(place[1]), float(place[2])


def _from_line(point: Array, start: Array, end: Array) -> float:
    """Distance of a point from a segment in the plane, each of shape (2,) [m]."""
    way = end - start
    share = float(np.clip((point - start) @ way / max(float(way @ way), 1e-12), 0.0, 1.0))
    return float(np.linalg.norm(point - start - share * way))
