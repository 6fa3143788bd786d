from __future__ import annotations

import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fg_gcs.errors import MissionError
from fg_gcs.track.sightings import MOST_LINES, Batch, Verdict, isotropic, parse_csv, parse_datagram

RIGHT = {"target": "boat", "time_s": 1.5, "position_enu_m": [1.0, 2.0, 3]}
HEADER = b"time_s,target,east_m,north_m,up_m\n"


def parse(data: bytes) -> Batch:
    return parse_datagram(data, 20.0, {"boat", "car"}, sigma_m=0.5, began_s=10.0)


def told(**changes: object) -> bytes:
    return json.dumps({key: value for key, value in {**RIGHT, **changes}.items() if value is not None}).encode()


def test_what_is_written_is_read() -> None:
    rng = np.random.default_rng(1)
    for _ in range(50):
        position, root, time_s = rng.normal(size=3) * 100.0, rng.normal(size=(3, 3)), float(rng.uniform(0, 9))
        covariance = root @ root.T
        lines = [
            told(time_s=time_s, position_enu_m=position.tolist(), covariance_m2=covariance.tolist(), colour="red"),
            told(time_s=None, age_s=0.25, target="car", sigma_m=[1.0, 2.0, 3.0]),
            told(sigma_m=2),
            told(),
        ]
        batch = parse(b"\n".join(lines) + b"\r\n\n")
        assert not batch.refused
        one, other, third, plain = batch.sightings
        assert (one.target, one.time_s, one.received_s) == ("boat", 10.0 + time_s, 20.0)
        assert one.position_enu_m.tolist() == position.tolist()
        assert one.covariance_m2.tolist() == covariance.tolist()
        assert (other.target, other.time_s) == ("car", 19.75)
        assert np.diag(other.covariance_m2).tolist() == [1.0, 4.0, 9.0]
        assert third.covariance_m2.tolist() == isotropic(2.0).tolist()
        assert plain.covariance_m2.tolist() == (0.25 * np.eye(3)).tolist()


@pytest.mark.parametrize(
    ("line", "verdict"),
    [
        (b"{", Verdict.MALFORMED),
        (b"null", Verdict.MALFORMED),
        (b"\xff\xfe", Verdict.MALFORMED),
        (b"[" * 3000, Verdict.MALFORMED),
        (told(padding="x" * 5000), Verdict.MALFORMED),
        (told(target=None), Verdict.MALFORMED),
        (told(target=["boat"]), Verdict.MALFORMED),
        (told(target="ship"), Verdict.UNKNOWN_TARGET),
        (told(time_s=None), Verdict.MALFORMED),
        (told(age_s=0.1), Verdict.MALFORMED),
        (told(time_s="1.5"), Verdict.MALFORMED),
        (told(time_s=True), Verdict.MALFORMED),
        (told(time_s=float("nan")), Verdict.MALFORMED),
        (told(time_s=float("inf")), Verdict.MALFORMED),
        (told(time_s=10**400), Verdict.MALFORMED),
        (told().replace(b"1.5", b"1e999"), Verdict.MALFORMED),
        (told().replace(b"1.5", b"9" * 4005)[:4096], Verdict.MALFORMED),
        (told(position_enu_m=None), Verdict.MALFORMED),
        (told(position_enu_m=[1, 2]), Verdict.MALFORMED),
        (told(position_enu_m=[1, 2, 3, 4]), Verdict.MALFORMED),
        (told(position_enu_m={"0": 1, "1": 2, "2": 3}), Verdict.MALFORMED),
        (told(position_enu_m=[1, 2, [3]]), Verdict.MALFORMED),
        (told(sigma_m=-0.5), Verdict.BAD_COVARIANCE),
        (told(sigma_m=1e200), Verdict.BAD_COVARIANCE),
        (told(sigma_m=[0.5, 0.5]), Verdict.MALFORMED),
        (told(sigma_m="0.5"), Verdict.MALFORMED),
        (told(covariance_m2=[[1, 0, 0]]), Verdict.MALFORMED),
        (told(covariance_m2=[[1, 0], [0, 1], [0, 0]]), Verdict.MALFORMED),
        (told(sigma_m=0.5, covariance_m2=np.eye(3).tolist()), Verdict.MALFORMED),
    ],
)
def test_what_cannot_be_used_is_counted_by_its_reason(line: bytes, verdict: Verdict) -> None:
    batch = parse(told() + b"\n" + line + b"\n" + told())
    assert dict(batch.refused) == {verdict: 1}
    assert len(batch.sightings) == 2


def test_of_too_many_lines_the_first_are_read() -> None:
    batch = parse(b"\n".join([told()] * (MOST_LINES + 7)))
    assert len(batch.sightings) == MOST_LINES
    assert dict(batch.refused) == {Verdict.FLOOD: 7}


anything = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=8),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=8), inner, max_size=4),
    max_leaves=10,
)


@given(st.binary(max_size=300))
@settings(max_examples=200, deadline=None)
def test_bytes_never_raise(data: bytes) -> None:
    batch = parse(data)
    assert len(batch.sightings) + sum(batch.refused.values()) == sum(1 for line in data.split(b"\n") if line.strip())


@given(st.dictionaries(st.sampled_from([*RIGHT, "age_s", "sigma_m", "covariance_m2"]), anything, max_size=3))
@settings(max_examples=300, deadline=None)
def test_objects_never_raise_and_what_passes_is_finite(changes: dict[str, object]) -> None:
    batch = parse(told(**changes))
    assert len(batch.sightings) + sum(batch.refused.values()) == 1
    for sighting in batch.sightings:
        assert sighting.position_enu_m.shape == (3,)
        assert sighting.covariance_m2.shape == (3, 3)
        assert np.isfinite([sighting.time_s, *sighting.position_enu_m, *sighting.covariance_m2.flat]).all()


def test_every_verdict_says_something_else_to_people() -> None:
    assert len({verdict.value for verdict in Verdict}) == len(Verdict)
    assert all(verdict.value and "\n" not in verdict.value for verdict in Verdict)


# --- files -----------------------------------------------------------------------------------------------------------


def test_a_file_is_read_in_its_order_with_columns_in_any() -> None:
    plain = parse_csv(HEADER + b"2.0,boat,1,2,3\n\n1.5, car ,-4,5e0,6\n", "seen.csv", 0.5)
    assert [(s.target, s.time_s, s.received_s, s.position_enu_m.tolist()) for s in plain] == [
        ("boat", 2.0, 2.0, [1.0, 2.0, 3.0]),
        ("car", 1.5, 1.5, [-4.0, 5.0, 6.0]),
    ]
    assert all(s.covariance_m2.tolist() == isotropic(0.5).tolist() for s in plain)
    other = parse_csv("\ufeffup_m,sigma_m,target,time_s,north_m,east_m\n3,2,boat,2,2,1\n6,,b,0,5,4".encode(), "f", 0.5)
    assert other[0].position_enu_m.tolist() == [1.0, 2.0, 3.0]
    assert other[0].covariance_m2.tolist() == isotropic(2.0).tolist()
    assert other[1].covariance_m2.tolist() == isotropic(0.5).tolist()


@pytest.mark.parametrize(
    ("data", "line", "word"),
    [
        (b"", 1, "time_s"),
        (b"1.0,boat,1,2,3\n", 1, "'1.0' is no column"),
        (b"time_s,target,east_m,north_m\n", 1, "'up_m' is missing"),
        (b"time_s,target,east_m,north_m,up_m,up_m\n", 1, "twice"),
        (b"time_s,target,east_m,north_m,up_m,sigma\n", 1, "'sigma' is no column"),
        (HEADER, 1, "no sighting"),
        (HEADER + b"1,boat,1,2\n", 2, "4 fields"),
        (HEADER + b"1,boat,1,2,3\n\n2,boat,1,x,3\n", 4, "north_m is 'x'"),
        (HEADER + b"nan,boat,1,2,3\n", 2, "time_s is 'nan'"),
        (HEADER + b"1,boat,1,2,1e999\n", 2, "up_m"),
        (HEADER + b"1,,1,2,3\n", 2, "target is empty"),
        (HEADER + b"1,boat,1,2,3\n\xff\n", 3, "UTF-8"),
        (HEADER + b'1,"boat,1,2,3\n', 2, ""),
        (HEADER + b"1,boat," + b"1" * 200_000 + b",2,3\n", 2, "limit"),
        (HEADER[:-1] + b",sigma_m\n1,boat,1,2,3,-1\n", 2, "sigma_m is -1"),
        (HEADER[:-1] + b",sigma_m\n1,boat,1,2,3,1e200\n", 2, "sigma_m is 1e+200"),
    ],
)
def test_a_wrong_file_is_told_in_one_line(data: bytes, line: int, word: str) -> None:
    with pytest.raises(MissionError) as caught:
        parse_csv(data, "seen.csv", 0.5)
    text = str(caught.value)
    assert text.startswith(f"seen.csv: line {line}: ")
    assert word in text
    assert "\n" not in text
    assert len(text) < 250


@given(st.binary(max_size=200))
@settings(max_examples=200, deadline=None)
def test_a_file_gives_sightings_or_a_mission_error(rows: bytes) -> None:
    try:
        sightings = parse_csv(HEADER + rows, "seen.csv", 0.5)
    except MissionError:
        return
    assert sightings
