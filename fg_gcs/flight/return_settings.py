"""What vehicles do that hear nothing any more, set as the plan of a flight has it."""

from __future__ import annotations

from fg_gcs.flight.custody import Custody
from fg_gcs.flight.failsafes import Failsafes
from fg_gcs.flight.fleet import Fleet
from fg_gcs.flight.journal import Journal
from fg_gcs.plan.by_themselves import LEAST_M
from fg_gcs.plan.flight_plan import FlightPlan


async def let_return(fleet: Fleet, plan: FlightPlan, failsafes: Failsafes, custody: Custody, journal: Journal) -> None:
    """Set what vehicles do that hear nothing any more as the plan has it; say what comes of it for all of them.

    Raises:
        VehicleError: a vehicle keeps its own way.
    """
    alone = plan.alone
    assert plan.task.lost_link is not None, "every flight has a rule"
    await failsafes.set(alone, plan.task.lost_link.runs_on_s)
    custody.returns_m = failsafes.returns_m
    vanished = alone.landing if failsafes.returns_m is None else alone.vanished
    first, second = (fleet.vehicles[row].address for row in vanished.pair)
    how = "all land where they are"
    if failsafes.returns_m is not None:
        lowest_m, highest_m = failsafes.returns_m.min(), failsafes.returns_m.max()
        how = f"all hover, return at heights of their own from {lowest_m:.1f} to {highest_m:.1f} m, and land"
    text = f"when this program is gone {how}: vehicles {first} and {second} come within {vanished.closest_m:.2f} m"
    moment = f"{vanished.after_s:.1f} s into the {vanished.stage}"
    if vanished.bad:
        moment += f"; two come closer than {LEAST_M:g} m from {100.0 * vanished.bad:.0f} % of all moments"
    journal.event("warning" if vanished.bad else "plan", f"{text} ({moment})")
    journal.recorder.know(
        vanished_returns=failsafes.returns_m is not None,
        vanished_separation_m=vanished.closest_m,
        vanished_bad_share=vanished.bad,
    )
