"""Every task of a flight has an owner here: what raises or hangs is noticed, told, and started again."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine
from contextlib import suppress
from typing import Any, Final, NamedTuple

from fg_gcs.flight.journal import Journal
from fg_gcs.flight.policy import ROWS, Fault, FaultKind

LOOKS: Final = 4.0  # times within a watchdog's time that a sign of life is sought
AGAIN_S: Final = 0.5  # between two starts of a task that dies again and again
MISSING: Final = 2  # in a row that find none: after a stall of the whole loop every task is late once
OFTEN: Final = 10  # deaths of one task that are told


class Duty(NamedTuple):
    """What a task of a flight does, and what is done when it cannot.

    Attributes:
        name: for people.
        work: makes the task's coroutine; it never ends by itself.
        turned_s: the loop's time of its newest sign of life [s].
        watchdog_s: it hangs if there is none for so long [s].
        dies: the fault that its first death is.
        dies_again: the fault that any further death is.
    """

    name: str
    work: Callable[[], Coroutine[Any, Any, None]]
    turned_s: Callable[[], float]
    watchdog_s: float
    dies: FaultKind
    dies_again: FaultKind

    @property
    def noticed_s(self) -> float:
        """How long it may take until it is noticed that it hangs [s]."""
        return self.watchdog_s * (1.0 + MISSING / LOOKS)


def bystander(
    name: str, work: Callable[[], Coroutine[Any, Any, None]], turned_s: Callable[[], float], watchdog_s: float
) -> Duty:
    """Return the duty of a task whose death changes nothing of the flight: it is told, and started again."""
    return Duty(name, work, turned_s, watchdog_s, FaultKind.BYSTANDER, FaultKind.BYSTANDER)


class Hung(Exception):
    """A task gave no sign of life.

    Args:
        name: of its duty.
        seconds: for how long.
    """

    def __init__(self, name: str, seconds: float) -> None:
        super().__init__(f"the {name} gave no sign of life for {seconds:.2f} s")


class Supervisor:
    """Owns tasks, see :class:`Duty`, from the beginning to the end of an ``async with``.

    Args:
        report: called with the fault that a death is.
        journal: where to tell of it.
        around: returns the duty that a task really gets.

    Attributes:
        deaths: what tasks died of, with their duties' names, in their order.
    """

    def __init__(
        self, report: Callable[[Fault], None], journal: Journal, around: Callable[[Duty], Duty] = lambda duty: duty
    ) -> None:
        self.deaths: list[tuple[str, Exception]] = []
        self._report = report
        self._journal = journal
        self._around = around
        self._group = asyncio.TaskGroup()
        self._owners: list[asyncio.Task[None]] = []

    async def __aenter__(self) -> Supervisor:
        await self._group.__aenter__()
        return self

    async def __aexit__(self, *raised: Any) -> None:  # noqa: ANN401 - as Python has it
        for owner in self._owners:
            owner.cancel()
        await self._group.__aexit__(None, None, None)  # what was raised inside goes on as it is, not in a group

    def start(self, duty: Duty) -> None:
        """Let a task do its duty, and start it again when it dies."""
        self._owners.append(self._group.create_task(self._own(self._around(duty)), name=duty.name))

    async def _own(self, duty: Duty) -> None:
        died = 0
        while True:
            try:
                await self._until_dead(duty)
            except Exception as error:  # whatever it is: it must not take the flight with it
                died += 1
                self._tell(duty, error, died)
            if died > 1:
                await asyncio.sleep(AGAIN_S)

    async def _until_dead(self, duty: Duty) -> None:
        """Run a task until it dies, or hangs, and end it.

        Raises:
            Exception: that it died of; whatever cancels it from inside or outside ends the task, and not its owner.
            Hung: it gives no sign of life.
        """
        loop = asyncio.get_running_loop()
        began_s = loop.time()
        task = asyncio.ensure_future(duty.work())
        missing = 0
        try:
            while not task.done():
                await asyncio.wait((task,), timeout=duty.watchdog_s / LOOKS)
                silent_s = loop.time() - max(duty.turned_s(), began_s)
                missing = missing + 1 if silent_s > duty.watchdog_s else 0
                if missing >= MISSING and not task.done():
                    raise Hung(duty.name, silent_s)
            if not task.cancelled():
                task.result()
            raise RuntimeError(f"the {duty.name} ended by itself")
        finally:
            task.cancel()
            with suppress(asyncio.CancelledError, Exception):
                await task

    def _tell(self, duty: Duty, error: Exception, died: int) -> None:
        self.deaths.append((duty.name, error))
        if died > OFTEN:
            return
        kind = duty.dies if died == 1 else duty.dies_again
        text = f"the {duty.name} {'hangs' if isinstance(error, Hung) else 'fails'}: {error!r}; {ROWS[kind].rung.does}"
        self._journal.event("error", text, fault=kind.value)
        self._report(Fault(kind, (), text, self._journal.time()))
