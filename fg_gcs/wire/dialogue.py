"""Dialogues: ask, ask again until the effect is seen, and tell this request's answers from those to earlier ones.

Times are for a link that loses 30 % of the datagrams each way and takes 150 ± 50 ms: within `DEADLINE_S` there is time
for 24 questions, all of which stay without an answer once in ten million times (0.51^24), and nothing is too late.
"""

import math
from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass
from enum import Enum
from itertools import chain, repeat
from typing import Final, NamedTuple, Protocol

from pymavlink.dialects.v20 import all as dialect

from fg_gcs.wire.codec import Message
from fg_gcs.wire.vehicle import Vehicle

DEADLINE_S: Final = 12.0
ROUND_TRIP_S: Final = 0.5  # the longest that an answer takes; up to then it may be to an earlier request
TEMPORARY_S: Final = 5.0  # "temporarily rejected" for so long is a refusal
_ALONE_S: Final = 5.0  # a request that nothing like it came before for so long cannot hear another's answer
_RESEND_S: Final = (0.3, 0.5)  # after the first question and after all others
_REASON_GRACE_S: Final = 0.4  # the texts that say why come up to this much after the refusal (chunks, 20 Hz at most)
_WARNING: Final[int] = dialect.MAV_SEVERITY_WARNING  # texts up to this severity tell why something was refused


class Answer(NamedTuple):
    """What a vehicle says to a request, beside what its telemetry shows.

    Attributes:
        at_s: When it came [s].
        refusal: Why it does not do it; empty: it has accepted, or is at it.
        temporary: It may do it if asked again.
    """

    at_s: float
    refusal: str = ""
    temporary: bool = False


def _silent(vehicle: Vehicle) -> Answer | None:
    """Never answered: the vehicle has no way to say anything."""
    return None


def _never(vehicle: Vehicle) -> str:
    """Always possible."""
    return ""


class State(Enum):
    """How a dialogue stands."""

    PENDING = "pending"
    DONE = "done"
    REFUSED = "refused"
    TIMED_OUT = "timed out"


class Exchange(Protocol):
    """A question on its way, whatever its kind; knows no clock: call `step` often (every 20 ms is plenty).

    Attributes:
        state: How it stands.
        reason: One line for people when it was refused or timed out; also kept when what was asked is optional.
    """

    state: State
    reason: str

    def step(self, now_s: float) -> Sequence[Message]:
        """Compare with the vehicle's telemetry; return the messages to send now, if any."""


class Question(Protocol):
    """What can be asked of a vehicle."""

    def dialogue(self, vehicle: Vehicle) -> Exchange:
        """Return a dialogue about it that has not begun."""


@dataclass(frozen=True, slots=True)
class Request:
    """One thing to get a vehicle to do, harmless when it arrives twice.

    Attributes:
        name: What the vehicle is to do, in the words that follow "did not".
        build: Messages to send, for the vehicle as it is now.
        satisfied: Telemetry shows that it is so; the second argument is when the first message left [s].
        answered: The newest answer, to this request or to another one like it.
        answered_by: What such answers are told by: requests that share it may get each other's answers.
        impossible: Reason why the vehicle cannot do it any more; empty while it still may.
        begun: Telemetry shows that the vehicle is at it, so it needs not be asked again.
        new_mode: The mode that the vehicle will change to, None if it stays.
        patience_s: A refusal counts only after it has been repeated for so long [s].
        temporary_s: The same for "temporarily rejected" [s].
        rest_s: Once accepted, ask again only after this long [s].
        deadline_s: Give up after this long [s].
        optional: A refusal does no harm: the dialogue counts as done.
    """

    name: str
    build: Callable[[Vehicle], Sequence[Message]]
    satisfied: Callable[[Vehicle, float], bool]
    answered: Callable[[Vehicle], Answer | None] = _silent
    answered_by: Hashable = None
    impossible: Callable[[Vehicle], str] = _never
    begun: Callable[[Vehicle], bool] | None = None
    new_mode: Callable[[Vehicle], int] | None = None
    patience_s: float = 0.0
    temporary_s: float = TEMPORARY_S
    rest_s: float = 0.0
    deadline_s: float = DEADLINE_S
    optional: bool = False

    def dialogue(self, vehicle: Vehicle) -> "Dialogue":
        """Return a dialogue with a vehicle about this that has not begun."""
        return Dialogue(vehicle, self)


class Dialogue:
    """Runs one request with one vehicle, see `Exchange`.

    Acknowledgements name a command and not the request, so one of them may be late or come to the wrong ears. A refusal
    therefore counts at once only if nothing else like this request was asked lately; else the vehicle is asked once
    more, at once, and what it says then counts.
    """

    def __init__(self, vehicle: Vehicle, request: Request) -> None:
        self.vehicle, self.request = vehicle, request
        self.state = State.PENDING
        self.reason = ""
        self._began_s: float | None = None
        self._alone = True
        self._deaf_until_s = -math.inf  # answers until then may be to earlier requests
        self._sent_s = -math.inf
        self._pauses_s = chain(_RESEND_S, repeat(_RESEND_S[-1]))
        self._pause_s = 0.0
        self._heard: Answer | None = None  # the newest answer that may be ours
        self._first_refusal_s: float | None = None
        self._confirmation_s = math.inf  # when it was asked again because of a refusal
        self._ends_s = math.inf  # the reasons for a refusal have had time to come

    def step(self, now_s: float) -> Sequence[Message]:
        """Compare with the vehicle's telemetry; return the messages to send now, if any.

        The first step always sends, even if the telemetry already shows success: it may be a second old.

        Raises:
            VehicleError: This autopilot cannot be asked that (see `commands.take_off`).
            UnsafeParameter: The value cannot be sent (see `commands.write_parameter`).
        """
        if self.state is not State.PENDING:
            return ()
        if self._began_s is None:
            return self._begin(now_s)
        self._listen()
        refusal = self._refusal()
        if self.request.satisfied(self.vehicle, self._began_s):
            self.state = State.DONE
        elif refusal:
            self._ends_s = min(self._ends_s, now_s + _REASON_GRACE_S)
            if now_s >= self._ends_s:
                self._finish(State.REFUSED, f": {refusal}")
        elif now_s - self._began_s >= self.request.deadline_s:
            said = f": {self._heard.refusal}" if self._heard is not None and self._heard.refusal else ""
            self._finish(State.TIMED_OUT, f" within {self.request.deadline_s:g} s{said}")
        elif self._is_due(now_s):
            return self._send(now_s)
        return ()

    def _begin(self, now_s: float) -> Sequence[Message]:
        self._began_s = now_s
        earlier_s = self.vehicle.asked_at_s.get(self.request.answered_by, -math.inf)
        self._deaf_until_s = max(now_s, earlier_s + ROUND_TRIP_S)
        self._alone = now_s - earlier_s > _ALONE_S
        if self.request.new_mode is not None:
            self.vehicle.command_mode(self.request.new_mode(self.vehicle))
        return self._send(now_s)

    def _send(self, now_s: float) -> Sequence[Message]:
        self._alone = self._alone and self._sent_s == -math.inf
        self._sent_s, self._pause_s = now_s, next(self._pauses_s)
        asked_at_s = self.vehicle.asked_at_s
        asked_at_s[self.request.name] = asked_at_s[self.request.answered_by] = now_s
        return self.request.build(self.vehicle)

    def _is_due(self, now_s: float) -> bool:
        heard = self._heard
        if self.request.begun is not None and self.request.begun(self.vehicle):
            return False
        if heard is not None and heard.refusal and not heard.temporary and self._confirmation_s == math.inf:
            self._confirmation_s = now_s
            return True
        rests = heard is not None and not heard.refusal and now_s - heard.at_s < self.request.rest_s
        return now_s - self._sent_s >= self._pause_s and not rests

    def _listen(self) -> None:
        answer = self.request.answered(self.vehicle)
        if answer is None or answer.at_s <= self._deaf_until_s:
            return
        self._heard = answer
        if answer.refusal and self._first_refusal_s is None:
            self._first_refusal_s = answer.at_s
        elif not answer.refusal and self.request.rest_s:  # PX4 accepts modes blindly: that takes no refusal back
            self._first_refusal_s = None

    def _refusal(self) -> str:
        """Return the refusal that counts, empty while none does."""
        impossible, heard = self.request.impossible(self.vehicle), self._heard
        if impossible or heard is None or self._first_refusal_s is None:
            return impossible
        patience_s = max(self.request.patience_s, self.request.temporary_s if heard.temporary else 0.0)
        if patience_s:
            counts = heard.at_s - self._first_refusal_s >= patience_s
        else:
            counts = self._alone or heard.at_s > self._confirmation_s
        return heard.refusal if counts else ""

    def _finish(self, state: State, how: str) -> None:
        began_s = self._began_s if self._began_s is not None else -math.inf
        self.reason = told(self.vehicle, f"{self.request.name}{how}", began_s)
        self.state = State.DONE if self.request.optional else state


def told(vehicle: Vehicle, what: str, since_s: float) -> str:
    """Return the line about what a vehicle did not do, with the reasons that it told.

    Args:
        vehicle: Whom it is about.
        what: It did not do, and how that ended.
        since_s: When it was asked [s].
    """
    said = [text.text for text in vehicle.recent_texts if text.at_s >= since_s and text.severity <= _WARNING]
    reasons = f" ({'; '.join(dict.fromkeys(said))})" if said else ""
    return f"vehicle {vehicle.address} did not {what}{reasons}"
