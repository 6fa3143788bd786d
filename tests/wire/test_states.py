import math

from hypothesis import given
from hypothesis import strategies as st

from fg_gcs.wire.states import State, StateTable

NUMBERS = st.floats(allow_nan=False)
STATES = st.builds(State, *[NUMBERS] * len(State._fields))


def test_before_anything_is_known_everything_is_nan_but_the_times() -> None:
    state = StateTable(3)[1]
    assert (state.boot_time_s, state.position_at_s) == (0.0, -math.inf)
    assert all(math.isnan(number) for number in state._replace(boot_time_s=math.nan, position_at_s=math.nan))


@given(states=st.lists(STATES, min_size=1, max_size=5), changed=STATES, row=st.integers(0, 4))
def test_rows_are_kept_apart_and_arrays_show_them(states: list[State], changed: State, row: int) -> None:
    table, row = StateTable(len(states)), row % len(states)
    for number, state in enumerate(states):
        table[number] = state
    table.set_motion(row, *changed[:8])
    table.set_ground(row, *changed[8:11])
    table.set_attitude(row, *changed[11:14])
    wanted = [*states[:row], changed, *states[row + 1 :]]
    assert [table[number] for number in range(len(states))] == wanted
    assert [table.numbers(number) for number in range(len(states))] == [tuple(state) for state in wanted]
    assert table.position_ned_m.tolist() == [list(state[:3]) for state in wanted]
    assert table.velocity_ned_m_s.tolist() == [list(state[3:6]) for state in wanted]
    assert table.position_at_s.tolist() == [state.position_at_s for state in wanted]
