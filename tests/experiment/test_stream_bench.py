"""The benchmark of streaming, small: what it says of deliveries and requirements, not of times."""

import asyncio

import pytest

from fg_gcs.errors import LinkError
from fg_gcs.experiment.bare_process import bare_vehicles, free_ports
from fg_gcs.experiment.baselines.ground_stations import Mavutil
from fg_gcs.experiment.stream_bench import OWN, Size, StreamBench, stream_bench
from fg_gcs.experiment.tables import NOTHING


def measured(size: Size) -> StreamBench:
    return asyncio.run(stream_bench(lambda _: None, size))


def test_every_setpoint_reaches_its_own_vehicle_in_every_network() -> None:
    made = measured(Size((2, 3), many=10, race_s=0.1, stream_s=0.5, others=False))
    assert [(row.station, row.vehicles) for row in made.setpoints] == [(OWN, 2), (OWN, 3)]
    assert [each.networks for each in (*made.streams, made.many)] == [1, 1, 4]
    for each in (*made.streams, made.many):
        assert each.wrong == 0
        assert 0 < each.right <= each.sent
        assert each.late_p99_ms <= each.late_worst_ms
    for row in made.setpoints:
        assert row.wrong == 0
        assert row.right >= 4 * row.vehicles
        assert row.ratio is not None
    assert made.mavutil_telemetry_us is None
    ratio, *_, wrong = made.figures()
    assert (ratio.required, ratio.met) == (NOTHING, True)  # of a large swarm alone
    assert (wrong.required, wrong.measured, wrong.met) == ("<= 0", 0.0, True)


def test_what_mavutil_sends_to_one_vehicle_reaches_all_of_them() -> None:
    made = measured(Size((3,), many=4, race_s=0.1, stream_s=0.3))
    mavutil = next(row for row in made.setpoints if row.station == "mavutil")
    assert mavutil.wrong == 2 * mavutil.right > 0
    assert made.mavutil_telemetry_us is not None
    mavsdk = next(row for row in made.setpoints if row.station == "MAVSDK")
    assert mavsdk.remark or mavsdk.right > 0


def test_a_library_that_is_not_installed_is_a_remark() -> None:
    size = Size((2,), many=4, race_s=0.1, stream_s=0.3)
    made = asyncio.run(stream_bench(lambda _: None, size, installed=lambda _: False))
    (mavsdk,) = (row for row in made.setpoints if row.station == "MAVSDK")
    assert (mavsdk.setpoint_us, mavsdk.ratio, mavsdk.remark) == (None, None, "not installed")


def test_a_vehicle_that_is_not_heard_is_one_line() -> None:
    async def hear() -> None:
        (port,) = free_ports(1)
        station = Mavutil(port)
        try:
            with bare_vehicles({port: [1, 2]}, 1.0):
                await station.hear([1, 2, 3], 2.0)
        finally:
            station.close()

    with pytest.raises(LinkError, match=r"mavutil hears 2 of 3 vehicles within 2 s"):
        asyncio.run(hear())
