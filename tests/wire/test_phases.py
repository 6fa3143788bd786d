from itertools import product

import pytest

from fg_gcs.wire.phases import TRANSITIONS, Phase, PhaseEvent, following

PAIRS = list(product(Phase, PhaseEvent))
AFTER_FLIGHT = {Phase.LANDED, Phase.LOST}


@pytest.mark.parametrize(("phase", "event"), PAIRS)
def test_every_pair(phase: Phase, event: PhaseEvent) -> None:
    after = following(phase, event)
    if (phase, event) in TRANSITIONS:
        assert after is not phase, "a transition that leads nowhere is not a transition"
    else:
        assert after is phase
    if event is PhaseEvent.SILENT:
        assert after is Phase.LOST
    if event is PhaseEvent.DISARMED:
        assert after not in {Phase.ARMED, Phase.FLYING, Phase.LANDING, Phase.TAKEN}
    if event is PhaseEvent.TAKEN_OVER:
        assert after not in {Phase.ARMED, Phase.FLYING, Phase.LANDING}
    if after is Phase.FLYING:
        assert phase is Phase.FLYING or (phase, event) in (
            (Phase.ARMED, PhaseEvent.AIRBORNE),
            (Phase.TAKEN, PhaseEvent.GIVEN_BACK),
        )


def test_hands_off_is_sticky() -> None:
    told = set(PhaseEvent) - {PhaseEvent.GIVEN_BACK}  # whatever telemetry says
    assert {following(Phase.TAKEN, event) for event in told} == {Phase.TAKEN, *AFTER_FLIGHT}


def test_a_lost_vehicle_comes_back_only_by_being_heard() -> None:
    assert [event for event in PhaseEvent if following(Phase.LOST, event) is not Phase.LOST] == [PhaseEvent.HEARD]


def test_every_phase_can_be_reached() -> None:
    assert {Phase.DISCOVERED, *TRANSITIONS.values()} == set(Phase)


def test_a_whole_flight() -> None:
    story = (
        PhaseEvent.CHECKS_PASSED,
        PhaseEvent.ARMED,
        PhaseEvent.AIRBORNE,
        PhaseEvent.LANDING_BEGAN,
        PhaseEvent.DISARMED,
        PhaseEvent.ARMED,
    )
    phase, visited = Phase.DISCOVERED, []
    for event in story:
        phase = following(phase, event)
        visited.append(phase)
    assert visited == [Phase.READY, Phase.ARMED, Phase.FLYING, Phase.LANDING, Phase.LANDED, Phase.ARMED]
