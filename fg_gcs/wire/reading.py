"""Reading parameters so that "unknown to this firmware" is told from "not heard"."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from pymavlink.dialects.v20 import all as dialect

from fg_gcs.wire.codec import Message
from fg_gcs.wire.dialogue import ROUND_TRIP_S, State, told
from fg_gcs.wire.vehicle import Vehicle

DEADLINE_S: Final = 30.0  # without its parameters a vehicle does not fly, so they are waited for
WORST_ANSWERED: Final = 0.49  # share of questions that a link answers which loses 30 % each way
_MOST_WRONG: Final = 3e-8  # chance, after any round, to take a parameter for unknown that was only not heard
_RESEND_S: Final = 0.3
_ALONE_ROUNDS: Final = 2  # most parameters are heard in the first rounds; what is not is asked for with another one
_REFUSALS: Final = {
    dialect.MAV_PARAM_ERROR_DOES_NOT_EXIST: "there is no parameter of this name",
    dialect.MAV_PARAM_ERROR_VALUE_OUT_OF_RANGE: "the value is out of range",
    dialect.MAV_PARAM_ERROR_PERMISSION_DENIED: "it must not be changed now",
    dialect.MAV_PARAM_ERROR_READ_ONLY: "it is read-only",
}


@dataclass(frozen=True, slots=True)
class Wanted:
    """One parameter to read.

    Attributes:
        names: Its names in different firmwares, of which a vehicle has one at most.
        needed: A vehicle whose firmware has no such parameter cannot be flown.
    """

    names: tuple[str, ...]
    needed: bool

    def __str__(self) -> str:
        return " or ".join(self.names)


@dataclass(frozen=True, slots=True)
class ReadParameters:
    """Read parameters into `Vehicle.params`, all side by side: their answers have names and cannot be confused.

    Attributes:
        wanted: Those to read; some sixteen names at most, real autopilots queue no more than twenty questions.
    """

    wanted: tuple[Wanted, ...]

    def dialogue(self, vehicle: Vehicle) -> "ReadingDialogue":
        """Return a dialogue with a vehicle about this that has not begun."""
        return ReadingDialogue(vehicle, self)


class ReadingDialogue:
    """Reads parameters of one vehicle, see `fg_gcs.wire.dialogue.Exchange`.

    PX4 refuses an unknown name, ArduPilot is silent. So silent names are asked for together with another parameter that
    the vehicle has told before: if that one is heard again and again, it is not the link that is silent, see
    `is_unknown`. What is unknown does no harm unless it is needed; what is not heard does, and is asked for to the end.
    """

    def __init__(self, vehicle: Vehicle, question: ReadParameters) -> None:
        self.vehicle, self.question = vehicle, question
        self.state = State.PENDING
        self.reason = ""
        self._missing = list(question.wanted)
        self._began_s: float | None = None
        self._sent_s = -math.inf
        self._rounds = 0
        self._other: str | None = None  # known to be there, to be heard when the others are not
        self._asked_s: list[float] = []  # when it was asked for
        self._heard = 0
        self._heard_at_s = -math.inf

    def step(self, now_s: float) -> Sequence[Message]:
        """Compare with what the vehicle has told; return the messages to send now, if any."""
        if self.state is not State.PENDING:
            return ()
        if self._began_s is None:
            self._began_s = now_s
            return self._send(now_s)
        self._count_other()
        self._missing = [one for one in self._missing if not self._is_heard(one, self._began_s)]
        unknown = {one: why for one in self._missing if (why := self._unknown(one, self._began_s, now_s))}
        needed = {str(one): why for one, why in unknown.items() if one.needed}
        self._missing = [one for one in self._missing if one not in unknown]
        if needed:
            self._finish(State.REFUSED, ", ".join(needed), f": {'; '.join(dict.fromkeys(needed.values()))}")
        elif not self._missing:
            self.state = State.DONE
        elif now_s - self._began_s >= DEADLINE_S:
            names = ", ".join(map(str, self._missing))
            others = f", but tells {self._other}" if self._heard else ""
            self._finish(State.TIMED_OUT, names, f" within {DEADLINE_S:g} s{others}")
        elif now_s - self._sent_s >= _RESEND_S:
            return self._send(now_s)
        return ()

    def _is_heard(self, one: Wanted, since_s: float) -> bool:
        return any(self.vehicle.param_at_s.get(name, -math.inf) > since_s for name in one.names)

    def _unknown(self, one: Wanted, since_s: float, now_s: float) -> str:
        """Return how it is known that the vehicle has no such parameter; empty: it may have it."""
        refusals = [parameter_refusal(self.vehicle, name, since_s) for name in one.names]
        if all(refusals):
            return refusals[0]
        if one.needed:
            return ""  # if it is only not heard, the flight can begin as soon as it is
        answered = sum(now_s - asked_s >= ROUND_TRIP_S for asked_s in self._asked_s)
        return "it is silent about it" if is_unknown(answered, min(self._heard, answered)) else ""

    def _send(self, now_s: float) -> Sequence[Message]:
        asked = [name for one in self._missing for name in one.names]
        if self._rounds >= _ALONE_ROUNDS and self._other is None:
            self._other = next((name for name in self.vehicle.params if name not in asked), None)
        self._rounds, self._sent_s = self._rounds + 1, now_s
        if self._other is not None:
            asked.append(self._other)
            self._asked_s.append(now_s)
        return [read(self.vehicle, name) for name in asked]

    def _count_other(self) -> None:
        if self._other is not None and self._asked_s:
            at_s = self.vehicle.param_at_s[self._other]
            if at_s > max(self._heard_at_s, self._asked_s[0]):
                self._heard_at_s = at_s
                self._heard += 1

    def _finish(self, state: State, names: str, how: str) -> None:
        self.reason = told(self.vehicle, f"tell its parameter {names}{how}", self._began_s or 0.0)
        self.state = state


def is_unknown(asked: int, heard: int) -> bool:
    r"""Tell whether a parameter that is not heard is unknown to the vehicle.

    If the vehicle knew it, and answered a share :math:`q` of all questions, the chance to hear :math:`m` of :math:`n`
    answers about another parameter and none about this one would be :math:`\binom{n}{m} q^m (1-q)^{2n-m}`. That is
    greatest for :math:`q = m/2n`, at most a half, so it is taken for the worst link that is flown on, which is just
    there. Without losses 13 questions are enough; with 30 % each way it takes some 24.

    Args:
        asked: How often both were asked for, n.
        heard: How often the other one was heard, m.
    """
    q = WORST_ANSWERED
    return math.comb(asked, heard) * q**heard * (1.0 - q) ** (2 * asked - heard) < _MOST_WRONG


def read(vehicle: Vehicle, name: str) -> Message:
    """Return the message that asks for one parameter."""
    message: Message = dialect.MAVLink_param_request_read_message(
        vehicle.system_id, dialect.MAV_COMP_ID_AUTOPILOT1, name.encode(), -1
    )
    return message


def parameter_refusal(vehicle: Vehicle, name: str, since_s: float) -> str:
    """Return why the vehicle would not read or write a parameter; empty: it has not said so since then [s]."""
    said = vehicle.param_errors.get(name)
    if said is None or said.at_s <= since_s:
        return ""
    return _REFUSALS.get(said.error, f"parameter error {said.error}")
