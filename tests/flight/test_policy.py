"""The policy is a table, and here it is walked completely: every fault, in every part of a flight, on every rung."""

from __future__ import annotations

from itertools import product
from pathlib import Path

import pytest

from fg_gcs.flight.policy import (
    ROWS,
    Care,
    FaultKind,
    Part,
    RequestKind,
    Rung,
    Situation,
    failures_table,
    refused,
    respond,
)

EVERYWHERE = [Situation(part, rung, stops) for part, rung, stops in product(Part, Rung, range(4))]
DOCS = Path(__file__).parents[2] / "docs"


def test_every_kind_has_a_row_and_every_row_says_everything() -> None:
    assert set(ROWS) == set(FaultKind)
    for row in ROWS.values():
        assert all((row.what, row.noticed, row.within, row.data))


@pytest.mark.parametrize("kind", FaultKind)
def test_a_fault_never_descends_and_climbs_no_higher_than_its_row(kind: FaultKind) -> None:
    for now in EVERYWHERE:
        response = respond(kind, now)
        idle = kind is FaultKind.STALL and now.part is Part.DESCENT  # nobody needs anything of a station then
        assert response.rung == (now.rung if idle else max(now.rung, ROWS[kind].rung))
        assert response.care is ROWS[kind].care


@pytest.mark.parametrize("kind", FaultKind)
def test_a_further_fault_plans_anew_on_the_same_rung_and_only_where_something_is_planned(kind: FaultKind) -> None:
    for now in EVERYWHERE:
        response = respond(kind, now)
        if now.part is not Part.FLIGHT or now.rung < Rung.HOME or ROWS[kind].rung < Rung.HOME:
            assert not response.again
        elif ROWS[kind].rung <= now.rung:
            assert response.again
            assert response.rung is now.rung


def test_faults_of_bystanders_and_what_is_mended_at_once_change_nothing() -> None:
    for kind in (FaultKind.BYSTANDER, FaultKind.STREAMER, FaultKind.PARAMETER):
        assert all(respond(kind, now).rung is now.rung and not respond(kind, now).again for now in EVERYWHERE)


@pytest.mark.parametrize(("stops", "rung"), [(1, Rung.HOME), (2, Rung.LANDING), (3, Rung.LAND_NOW), (9, Rung.LAND_NOW)])
def test_people_climb_by_asking_again(stops: int, rung: Rung) -> None:
    for part, before in product(Part, Rung):
        assert respond(RequestKind.STOP, Situation(part, before, stops)).rung == max(before, rung)


def test_only_people_and_a_streamer_that_is_dead_land_at_once() -> None:
    at_once = {kind for kind in FaultKind if respond(kind, Situation(Part.FLIGHT, Rung.GO_ON)).rung is Rung.LAND_NOW}
    assert at_once == {FaultKind.STREAMER_AGAIN}


def test_a_plan_that_is_refused_climbs_one_rung_and_the_last_one_stays() -> None:
    for part in Part:
        climbed = [refused(Situation(part, rung)).rung for rung in Rung]
        assert climbed == [Rung.HOME, Rung.HOME, Rung.LANDING, Rung.LAND_NOW, Rung.LAND_NOW]


def test_who_is_given_up_is_kept_clear_of() -> None:
    for row in ROWS.values():
        if row.care in (Care.LAND, Care.LEAVE):
            assert row.rung >= Rung.HOME  # nobody flies on beside a vehicle that may be anywhere


def test_the_page_on_failures_has_the_table_as_it_is() -> None:
    assert failures_table() in (DOCS / "failures.md").read_text()
