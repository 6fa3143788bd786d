"""Networks with and without a key behind one router, in virtual time."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence

import numpy as np

from fg_gcs.link.endpoint import Endpoint, Kind
from fg_gcs.link.router import Direction, Router
from fg_gcs.wire import commands
from fg_gcs.wire.codec import SIGNED, Frame
from fg_gcs.wire.framing import Frames, Sender
from fg_gcs.wire.setpoint import NUMBERS, SetpointRound
from fg_gcs.wire.signing import Signing, Stamps, stamp_of
from tests.link.test_router import GROUND, PORT, Fake, at, settle, virtually

KEY = bytes(range(32))
OTHER_GROUND = Endpoint(Kind.UDP_IN, "127.0.0.1", PORT + 1)


def signing() -> Signing:
    return Signing(KEY, Stamps(lambda: 0.0, stamp_of(1.7e9)))


async def fakes_of_both() -> tuple[Fake, Fake]:
    signed, plain = await Fake.start(1), await Fake.start(1, local=20_000)
    signed.sender = Sender(1, 1, signing().signature(0))
    plain.target = OTHER_GROUND.host, OTHER_GROUND.port
    return signed, plain


def raws(heard: list[object]) -> list[bytes]:
    return [frame.raw for frame in heard if isinstance(frame, Frame)]


def test_a_round_to_both_is_signed_for_one_and_not_for_the_other() -> None:
    async def main() -> None:
        sent: list[bytes] = []

        def tap(direction: Direction, frames: Sequence[bytes] | Frames, now_s: float) -> None:
            if direction is Direction.OUT:
                sent.extend(bytes(frame) for frame in frames)

        judge = signing()
        router = await Router.open({"east": [GROUND], "west": [OTHER_GROUND]}, tap=tap, signing={"east": signing()})
        signed, plain = await fakes_of_both()
        for fake in (signed, plain):
            fake.beat()
        await settle()
        both = (at(1, "east"), at(1, "west"))
        assert set(router.vehicles) == set(both)
        for value in range(3):
            routes = router.routes(both)
            numbers = np.full((2, NUMBERS), float(value))
            router.send_all(routes, SetpointRound([1, 1], routes.senders).pack(numbers))
        for address in both:
            router.send_message(address, commands.heartbeat())
        await settle()
        assert [message.get_type() for message in signed.heard] == [message.get_type() for message in plain.heard]
        assert sorted(raws([*signed.heard, *plain.heard])) == sorted(sent)
        assert all(judge.refusal(frame) is None for frame in signed.heard if isinstance(frame, Frame))
        assert {raw[2] for raw in raws([*plain.heard])} == {0}
        assert {raw[2] for raw in raws([*signed.heard])} == {SIGNED}
        assert (plain.codec.bad_bytes, signed.codec.bad_bytes, router.counters.frames_out) == (0, 0, 8)
        router.close()

    virtually(main)


def test_heartbeats_and_questions_for_the_time_go_to_both() -> None:
    async def main() -> None:
        router = await Router.open({"east": [GROUND], "west": [OTHER_GROUND]}, signing={"east": signing()})
        signed, plain = await fakes_of_both()
        beating = asyncio.ensure_future(router.keep_alive())
        for _ in range(4):
            for fake in (signed, plain):
                fake.beat()
            await settle(0.5)
        beating.cancel()
        for fake, flags in ((signed, SIGNED), (plain, 0)):
            assert {"HEARTBEAT", "TIMESYNC"} <= set(fake.names())
            assert {raw[2] for raw in raws([*fake.heard])} == {flags}
            assert [message.get_seq() for message in fake.heard] == list(range(len(fake.heard)))
        router.close()

    virtually(main)


def test_a_key_that_is_given_to_a_vehicle_is_in_no_log() -> None:
    async def main() -> None:
        logged: list[bytes] = []
        router = await Router.open(
            {"main": [GROUND]},
            tap=lambda _, frames, __: logged.extend(bytes(frame) for frame in frames),
            signing={"main": (ours := signing())},
        )
        ours.sets_up = True
        fake = await Fake.start(1)
        fake.beat()
        await settle()
        router.send_message(at(1), ours.set_up(1))
        await settle()
        assert fake.names() == ["SETUP_SIGNING"]
        assert bytes(fake.heard[0].secret_key) == KEY
        assert not any(KEY[:8] in frame for frame in logged)
        router.close()

    virtually(main)


def test_a_frame_that_is_repeated_from_elsewhere_makes_no_second_vehicle() -> None:
    async def main() -> None:
        router = await Router.open({"main": [GROUND]}, signing={"main": signing()})
        fake, attacker = (await fakes_of_both())[0], await Fake.start(1)
        for _ in range(5):
            frame = fake.sender.pack(commands.heartbeat())
            fake.transport.sendto(frame)
            attacker.transport.sendto(frame)
            attacker.beat()
        fake.beat()
        await settle(0.1)
        counters = router.counters
        assert (counters.replayed, counters.unsigned, counters.clashes) == (5, 5, 0)
        assert len(router.notices) == 2
        router.close()

    virtually(main)
