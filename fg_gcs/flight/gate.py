"""The last gate before the wire: every setpoint passes it, and what must not leave is changed, braked or held back.

A setpoint leaves as it is if

- its numbers are finite;
- it goes on from the one before: ``|p' - p - v dt| <= 2 a dt^2 / 2 + 0.01 m``, ``|v' - v| <= 2 a dt + 0.1 m/s`` and
  ``|a'| <= 2 a`` with the mission's limit of acceleration a, which motions use up to 11/8 of while they come to rest.
  A vehicle that nothing has left for within 0.5 s, or that stands below the floor, takes off: its setpoint is at most
  1 m away horizontally, and above;
- it is inside the fence, or no farther outside than the one before, and no faster towards it than braking by a allows:
  ``v <= sqrt(2 a d) + 0.02 m/s`` for a distance d;
- it is no nearer than the minimum to any other setpoint of the round, or, of a pair that is nearer already, no nearer
  than before, and the minimum is kept while both brake along their relative velocity w, over ``w^2 / (2 2 a)``, see
  `core.admissible.fastest`. Who flies straight at each other and is faster breaks the minimum whatever the limits let
  it do, and who passes on straight lines may be as fast as it likes, so that verified plans pass. Likewise to where
  vehicles are reported that get no setpoints, and to what is kept clear of those (`Custody.kept_clear`), by the least
  clearance that ways home are planned with.

What does not pass becomes the nearest setpoint that does (`core.mending.nearest`); that of a pair of which both come
nearer, each by its share. If the position would change by more than 0.5 m, or if there is none, the vehicle is braked:
from what left last it comes to rest, by a, or by 2 a before a fence or another vehicle. Whoever got nothing lately is
sent nothing. Standing still always passes, so what is braked stays until its motion comes back to it; after `LASTS_S`
the flight is told.

Looking at all pairs is needed only now and then: pairs that were far apart are left out until vehicles have moved
against each other far enough to have met.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Final, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from fg_gcs.core import admissible, mending
from fg_gcs.core.admissible import Around
from fg_gcs.core.arrays import Array
from fg_gcs.flight.motions import SwarmSetpoint
from fg_gcs.plan.keep_clear import Column
from fg_gcs.plan.landing import clearings_m
from fg_gcs.plan.limits import Rules
from fg_gcs.wire.setpoint import NUMBERS

LASTS_S: Final = 1.0  # a setpoint that does not pass for so long is a fault of its motion
FENCE_M: Final = 0.05  # between the instants at which plans are verified they bend by less
SEPARATION_M: Final = 0.01  # likewise
GROUND_M: Final = 0.5  # lower than that a vehicle stands, whatever the floor is
LEAST_M_S2: Final = 0.5  # motions come to rest by that at least
_REASONS: Final = {
    admissible.NOT_FINITE: "not finite",
    admissible.JUMP: "jump",
    admissible.FENCE: "fence",
    admissible.NEAR: "separation",
    admissible.KEPT_CLEAR: "kept clear",
}
_OLD: Final = -1e18  # s; a time at which nothing left, but `admissible.NEVER` says more


class Change(NamedTuple):
    """What became of one setpoint that did not pass."""

    row: int  # of the fleet
    status: int  # `mending.CHANGED`, `BRAKED` or `HELD_BACK`
    reasons: tuple[str, ...]
    by_m: float  # how far its position was moved; NaN where it was no position
    other: int  # row of the vehicle that it was too near to; -1: none
    distance_m: float  # from that


class Passed(NamedTuple):
    """What may leave of a round."""

    rows: NDArray[np.int_]
    numbers: Array  # (n, 10) position, velocity, acceleration, yaw [ENU]
    changes: tuple[Change, ...] = ()


class GateCounts(NamedTuple):
    """How often setpoints did not pass, by what became of them."""

    changed: int
    braked: int
    held_back: int
    reasons: dict[str, int]

    @property
    def total(self) -> int:
        """How many setpoints did not leave as they were wanted."""
        return self.changed + self.braked + self.held_back


class Reported(Protocol):
    """What vehicles of a fleet tell; `Fleet` is one."""

    @property
    def armed(self) -> NDArray[np.bool_]:
        """Whose motors run, shape (V,)."""

    def positions_enu_m(self, now_s: float) -> Array:
        """Return where they are at one instant, shape (V, 3) [m; ENU]."""


class Gate:
    """Lets setpoints of a fleet leave, round by round.

    Args:
        fleet: with its frames, once setpoints are to leave.
        rules: limits, separation and fence.
        kept_clear: tells what the plans that are flown keep clear.
    """

    def __init__(
        self, fleet: Reported, rules: Rules, kept_clear: Callable[[], Mapping[int, Sequence[Column]]] = dict
    ) -> None:
        mending.build()  # no round waits for a compiler
        count = len(fleet.armed)
        self._fleet, self._kept_clear = fleet, kept_clear
        self._clear_m = min(clearings_m(rules))
        self._apart_m = rules.separation_m
        acceleration = max(rules.limits.acceleration_m_s2, LEAST_M_S2)
        low, high = np.array(rules.fence.low_enu_m) - FENCE_M, np.array(rules.fence.high_enu_m) + FENCE_M
        ground_m = max(low[2], GROUND_M)
        self._bounds = np.concatenate((low, high, (rules.separation_m - SEPARATION_M, acceleration, ground_m)))
        self._told = np.full((count, 8), np.nan)
        self._told[:, 7] = _OLD
        self._rows: NDArray[np.int_] | None = None  # of the round before
        self._all_sent = False
        self._pairs = np.empty((0, 2), dtype=np.int64)
        self._built = np.empty((0, 3))
        self._codes = np.zeros(count, dtype=np.int64)
        self._since_s = np.full(count, np.nan)  # since when a vehicle's setpoints do not pass
        self._statuses = Counter[int]()
        self._reasons = Counter[str]()
        self._nothing = Around(np.empty((0, 4)), np.empty((0, 6)))

    @property
    def counts(self) -> GateCounts:
        """How often setpoints did not pass so far."""
        changed, braked, held_back = (
            self._statuses[kind] for kind in (mending.CHANGED, mending.BRAKED, mending.HELD_BACK)
        )
        return GateCounts(changed, braked, held_back, dict(self._reasons))

    def passed(self, rows: NDArray[np.int_], numbers: Array, now_s: float) -> Passed:
        """Return what may leave of a round; what may is noted as sent.

        Args:
            rows: of the fleet, that get setpoints; the same array as long as they are the same.
            numbers: position, velocity, acceleration and yaw, shape (n, 10) [m, m/s, m/s^2, rad; ENU].
            now_s: the loop's time [s].
        """
        if rows is not self._rows:
            self._rows, self._all_sent = rows, len(np.unique(rows)) == len(self._told)
            self._built = np.empty((0, 3))
        around = self._nothing if self._all_sent else self._around(rows, now_s)
        codes = self._codes[: len(rows)]
        while True:
            failed = admissible.judge(
                rows, numbers, self._told, now_s, self._bounds, self._pairs, self._built, *around, codes
            )
            if failed == admissible.STALE:
                self._look_where_they_are(rows, now_s)
            elif failed == admissible.REBUILD:
                self._find_pairs(numbers)
            else:
                break
        if failed:
            return self._mended(rows, numbers, now_s, around)
        if self._reasons:
            self._since_s[rows] = np.nan
        return Passed(rows, numbers)

    def lasting(self, now_s: float) -> list[int]:
        """Return the rows of the vehicles whose setpoints have not passed for `LASTS_S`."""
        rows: list[int] = np.flatnonzero(now_s - self._since_s >= LASTS_S).tolist() if self._reasons else []
        return rows

    def last(self, rows: Sequence[int]) -> SwarmSetpoint:
        """Return what left last for some vehicles, without accelerations."""
        told = self._told[list(rows)]
        return SwarmSetpoint(told[:, 0:3], told[:, 3:6], np.zeros((len(told), 3)), told[:, 6])

    @property
    def acceleration_m_s2(self) -> float:
        """The limit by which vehicles come to rest [m/s^2]."""
        return float(self._bounds[7])

    def forgive(self) -> None:
        """Count anew for how long setpoints do not pass: other motions follow."""
        self._since_s[:] = np.nan

    def told(self, now_s: float) -> tuple[Array, Array]:
        """Return where vehicles are told to be and how fast, shape (V, 3) each [m, m/s; ENU]; NaN: nothing left lately.

        Args:
            now_s: the loop's time; what left is carried on to it [s].
        """
        since_s = now_s - self._told[:, 7]
        lately = since_s <= admissible.GAP_S
        velocity = np.where(lately[:, None], self._told[:, 3:6], np.nan)
        place: Array = self._told[:, 0:3] + velocity * np.where(lately, since_s, 0.0)[:, None]
        return place, velocity

    def _look_where_they_are(self, rows: NDArray[np.int_], now_s: float) -> None:
        """Let first setpoints, and those after a gap, be compared with where the vehicles are reported."""
        old = rows[now_s - self._told[rows, 7] > admissible.GAP_S]
        self._told[old] = 0.0
        self._told[old, 0:3] = self._fleet.positions_enu_m(now_s)[old]
        self._told[old, 7] = admissible.NEVER

    def _find_pairs(self, numbers: Array) -> None:
        """Find out anew which vehicles may be near each other."""
        axis = int(np.argmax(np.ptp(numbers[:, 0:3], axis=0)))
        order = np.argsort(numbers[:, axis])
        most = max(8 * len(numbers), 64)
        self._built = np.empty((len(numbers) + 1, 3))
        while True:
            pairs = np.empty((most, 2), dtype=np.int64)
            count = admissible.near_pairs(numbers, order, axis, self._bounds, pairs, self._built)
            if count <= most:
                self._pairs = pairs[:count]
                return
            most = count

    def _around(self, rows: NDArray[np.int_], now_s: float) -> Around:
        """Return what is kept away from beside the round's own setpoints."""
        unsent, places = self._fleet.armed, self._fleet.positions_enu_m(now_s)
        unsent[rows] = False
        unsent &= np.isfinite(places).all(axis=1)
        points = [(*place, self._apart_m) for place in places[unsent].tolist()]
        sent = set(rows.tolist())  # of who is still told where to be, that counts
        kept_clear = self._kept_clear().items()
        columns = [column for row, columns in kept_clear if row not in sent for column in columns]
        points += [(*column.place_enu_m, self._clear_m) for column in columns if column.place_enu_m is not None]
        lines = [
            (*column.start_enu_m, *column.end_enu_m, column.top_m + self._clear_m, column.radius_m + self._clear_m)
            for column in columns
        ]
        slack_m = SEPARATION_M
        made = Around(np.array(points).reshape(-1, 4), np.array(lines).reshape(-1, 6))
        made.points[:, 3] -= slack_m
        made.columns[:, 4:] -= slack_m
        return made

    def _mended(self, rows: NDArray[np.int_], numbers: Array, now_s: float, around: Around) -> Passed:
        """Return a round of which some setpoints did not pass."""
        out, notes = np.empty((len(rows), NUMBERS)), np.empty((len(rows), mending.NOTES))
        mending.mend(rows, numbers, self._told, now_s, self._bounds, *around, out, notes)
        status = notes[:, mending.STATUS].astype(int)
        touched = status != mending.UNCHANGED
        self._since_s[rows[~touched]] = np.nan
        started = rows[touched & np.isnan(self._since_s[rows])]
        self._since_s[started] = now_s
        held = status == mending.HELD_BACK
        self._told[rows[held], 7] = _OLD  # they are looked at again, from where they are then
        changes = tuple(self._changes(rows, notes))
        for change in changes:
            self._statuses[change.status] += 1
            self._reasons.update(change.reasons)
        return Passed(rows[~held] if held.any() else rows, out[~held] if held.any() else out, changes)

    def _changes(self, rows: NDArray[np.int_], notes: Array) -> Iterator[Change]:
        for place in np.flatnonzero(notes[:, mending.STATUS]).tolist():
            status, code, by_m, other, distance_m = notes[place].tolist()
            reasons = tuple(reason for bit, reason in _REASONS.items() if int(code) & bit)
            near = int(rows[int(other)]) if other >= 0.0 else -1
            yield Change(int(rows[place]), int(status), reasons, by_m, near, distance_m)
