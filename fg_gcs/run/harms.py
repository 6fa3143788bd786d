"""What trials do to the ground station itself: a task dies or hangs, the whole of it stands still, strangers speak."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from typing import Final, Literal, NamedTuple

from fg_gcs.flight.supervisor import Duty
from fg_gcs.link.clock import VirtualTimeLoop, ticks
from fg_gcs.run.planning import PROFILES
from fg_gcs.run.simulators import Simulator
from fg_gcs.wire.bare import Speaker

StrangerKind = Literal["station", "twin"]

SPEAKS_S: Final = 0.1  # between two positions of a twin
BEATS: Final = 10  # of those to a heartbeat


class Death(NamedTuple):
    """A task of the flight that dies, or hangs, so long after a stage has begun."""

    task: str  # by its duty's name
    hangs: bool
    stage: str
    after_s: float

    @property
    def text(self) -> str:
        """For people."""
        return f"the {self.task} {'hangs' if self.hangs else 'dies'} {self.after_s:g} s into {self.stage}"


class Stall(NamedTuple):
    """The whole station stands still, as a process that is stopped, so long after a stage has begun."""

    lasts_s: float
    stage: str
    after_s: float

    @property
    def text(self) -> str:
        """For people."""
        return f"the station stands still for {self.lasts_s:g} s, {self.after_s:g} s into {self.stage}"


class Stranger(NamedTuple):
    """Somebody who speaks to our port from then on: another station, or a second vehicle with an id of ours."""

    kind: StrangerKind
    system_id: int  # of the vehicle that has a twin
    stage: str
    after_s: float

    @property
    def text(self) -> str:
        """For people."""
        who = "another station" if self.kind == "station" else f"a second vehicle {self.system_id}"
        return f"{who} speaks from {self.after_s:g} s into {self.stage} on"


class Struck(Exception):
    """What a task dies of that is struck."""


class Deaths:
    """Lets tasks of a flight die, or hang; give :meth:`around` to its director."""

    def __init__(self) -> None:
        self._struck: dict[str, asyncio.Future[bool]] = {}  # by the names of duties; whether they hang
        self._noticed_s: dict[str, float] = {}

    def around(self, duty: Duty) -> Duty:
        """Return the duty with a task that can be struck."""
        self._noticed_s[duty.name] = duty.noticed_s
        return duty._replace(work=partial(self._work, duty))

    def noticed_s(self, death: Death) -> float:
        """Return how long it may take until it is noticed [s]."""
        return self._noticed_s[death.task]

    def strike(self, death: Death) -> bool:
        """Let a task die or hang, and say whether there is such a task."""
        struck = self._struck.get(death.task)
        if struck is None or struck.done():
            return False
        struck.set_result(death.hangs)
        return True

    async def _work(self, duty: Duty) -> None:
        struck = self._struck[duty.name] = asyncio.get_running_loop().create_future()
        task = asyncio.ensure_future(duty.work())
        try:
            await asyncio.wait((task, struck), return_when=asyncio.FIRST_COMPLETED)
            if task.done():
                return task.result()
        finally:
            task.cancel()
            with suppress(asyncio.CancelledError, Exception):
                await task
        if struck.result():
            await asyncio.Event().wait()
        raise Struck(duty.name)


def stand_still(simulator: Simulator, seconds: float, every_s: float, look: Callable[[], None]) -> None:
    """Let the simulator go on while nothing else on this loop runs, as if its process were stopped.

    What vehicles say meanwhile waits for the station, all of it, as in a system's buffers that are large enough.

    Args:
        simulator: on the running loop, in virtual time.
        seconds: for how long [s].
        every_s: between two looks [s].
        look: called then.
    """
    loop = asyncio.get_running_loop()
    assert isinstance(loop, VirtualTimeLoop)
    loop.settle()
    simulator.pause()
    for _ in range(round(seconds / every_s)):
        simulator.step(every_s)
        look()
    loop.stand_still(seconds)
    simulator.resume()


async def speak(stranger: Stranger, autopilot: str, port: int) -> None:
    """Speak to a port of the loopback, for ever."""
    loop = asyncio.get_running_loop()
    transport, _ = await loop.create_datagram_endpoint(asyncio.DatagramProtocol, remote_addr=("127.0.0.1", port))
    began_s = loop.time()
    speaker = Speaker(stranger.system_id, PROFILES[autopilot].autopilot if stranger.kind == "twin" else None)
    try:
        async for k, _ in ticks(began_s, SPEAKS_S):
            if k % BEATS == 0:
                transport.sendto(speaker.heartbeat())
            if stranger.kind == "twin":
                transport.sendto(speaker.position(loop.time() - began_s))
    finally:
        transport.close()
