import asyncio

import pytest
from pymavlink.dialects.v20 import all as dialect

from fg_gcs.flight.link_check import unfit_links
from fg_gcs.link.clock import VirtualTimeLoop
from fg_gcs.link.endpoint import Endpoint, Kind
from fg_gcs.link.router import Router
from fg_gcs.wire.address import MAIN
from fg_gcs.wire.framing import Sender

PORT = 14550


async def speaking(system_id: int, lost: int, seconds: float) -> None:
    """Speak 50 times a second; of every ten frames so many are lost."""
    transport, _ = await asyncio.get_running_loop().create_datagram_endpoint(
        asyncio.DatagramProtocol, remote_addr=("127.0.0.1", PORT)
    )
    sender = Sender(system_id, 1)
    for k in range(int(50 * seconds)):
        frame = sender.pack(dialect.MAVLink_heartbeat_message(2, 12, 1, k, 3, 3))
        if k % 10 >= lost:
            transport.sendto(frame)
        await asyncio.sleep(0.02)


@pytest.mark.parametrize(
    ("links", "reason"),
    [
        (((1, 0), (2, 3)), None),
        (
            ((1, 0), (2, 6), (3, 6)),
            "the link is too bad to fly over: vehicles 2-3 (60 % of its frames are lost (most 50 %))",
        ),
        (((1, 0), (1, 0)), "two vehicles have the system id 1: at 127.0.0.1:49152 and at 127.0.0.1:49153"),
    ],
)
def test_links_are_judged_in_one_line(links: tuple[tuple[int, int], ...], reason: str | None) -> None:
    async def main() -> str | None:
        router = await Router.open({MAIN: [Endpoint(Kind.UDP_IN, "127.0.0.1", PORT)]})
        beating = asyncio.create_task(router.keep_alive())
        await asyncio.gather(*(speaking(system_id, lost, 10.0) for system_id, lost in links))
        beating.cancel()
        found = unfit_links(router, list(router.vehicles.values()))
        router.close()
        return found

    with asyncio.Runner(loop_factory=VirtualTimeLoop) as runner:
        assert runner.run(main()) == reason


def test_a_clock_that_runs_slow_keeps_all_on_the_ground() -> None:
    async def main() -> list[str | None]:
        router = await Router.open({MAIN: [Endpoint(Kind.UDP_IN, "127.0.0.1", PORT)]})
        await speaking(3, 0, 1.0)
        (vehicle,) = router.vehicles.values()
        for k in range(12):
            vehicle.timing.asked(k, 0.5 * k)
            vehicle.timing.answered(round(0.8e9 * 0.5 * k) + 1, k, 0.5 * k)
        found = [unfit_links(router, [vehicle], least) for least in (0.0, 0.79, 0.95)]
        router.close()
        return found

    with asyncio.Runner(loop_factory=VirtualTimeLoop) as runner:
        *flown, slow = runner.run(main())
    assert flown == [None, None]
    assert slow == (
        "the machine is too slow for these simulators: the clock of vehicle 3 runs at 0.800 of real time "
        "(least 0.95); fly fewer, or all the same with --slow-machine-ok"
    )
