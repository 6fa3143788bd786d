"""How good the link of one vehicle is, and what its clock reads: loss, delay, jitter, and the order of its samples.

A vehicle stamps what it says with the time since its boot. By TIMESYNC we say our time, and the vehicle answers with
its own and ours. Arrival less stamp is offset plus delay, so the least of it counts, and for each direction by itself:
delay = (least in + least out) / 2 and offset = least of the stamped samples - delay, right where the least delays of
both directions are the same, whatever their jitter [Mills2010]_. A vehicle that does not answer is given the least
delay of its stamped samples as if that were none. Takes times, knows no clock and no socket.
"""

from __future__ import annotations

import math
from collections import deque
from typing import Final, NamedTuple

from pymavlink.dialects.v20 import all as dialect

from fg_gcs.wire.codec import Message
from fg_gcs.wire.sequence import SequenceCounter

DRIFT: Final = 1e-4  # of a vehicle's clock against ours, twice what quartz has; what was learnt fades by it
SLACK_S: Final = 0.01  # stamps are whole milliseconds, and machines are busy
LEAST_SHARE: Final = 0.5  # of the least round trip: least delays that add up to less are of a clock that has moved
ANSWER_S: Final = 2.5  # an answer that takes longer is lost: the delay of each way may be 1 s
PACED: Final = 32  # answers that the pace of a vehicle's clock is told by: a quarter of a minute
PACE_S: Final = 3.0  # they must lie so far apart: an answer that is 20 ms late changes it by less than a hundredth
LEAST_PACE: Final = 0.95  # real SITL keeps 0.987 and more; on a machine too busy one was 9 m off its circle
OUTCOMES: Final = 64  # requests whose answers are counted: half a minute on the ground, six seconds in flight
ROUND_TRIPS: Final = 16  # of which the delay is the mean
MOST_LATE_S: Final = 4.0  # samples come late, or a second time, by less; what is older is of another boot
MOST_BOOT_S: Final = 120.0  # a vehicle that restarted is heard with its position before that: ArduPilot after 41 s
MOST_AHEAD_S: Final = 10.0  # that stamps may go on faster than time does: a link that was stuck empties itself
CONSISTENT: Final = 5  # samples in a row, at the pace of time, before a restart is believed
SURELY_CONSISTENT: Final = 25  # and before a clock that jumped is: a link that was stuck looks the same at first
CONSISTENT_S: Final = 0.25  # how far the delays of such samples may differ

MOST_LOSS: Final = 0.5  # setpoints at 20 Hz still come every tenth of a second; with 30 % each way flights complete
MOST_DELAY_S: Final = 1.0  # at 5 m/s a vehicle is 5 m further on before it is seen, and 10 m before it hears of it
MOST_JITTER_S: Final = 0.25  # setpoints every 50 ms would arrive five places out of order
RARE: Final = 1e-5  # so seldom the answers of a vehicle that hears us stay away often enough to be taken for deafness
SURE: Final = 2.0  # standard deviations: a share that is counted of few requests is not yet believed


def timesync(said_ns: int) -> Message:
    """Return the question for a vehicle's time, which says ours [ns]."""
    message: Message = dialect.MAVLink_timesync_message(0, said_ns)
    return message


class LinkQuality(NamedTuple):
    """How good the link of one vehicle is now; what is not known is NaN.

    Attributes:
        loss_in: Share of its frames that do not reach us, 0 to 1, by the gaps of their sequence numbers.
        loss_out: Share of our frames that do not reach it, 0 to 1, by TIMESYNC requests without an answer.
        delay_s: Mean delay of one way, half the round trip [s].
        jitter_s: Mean change of the delay from one sample to the next [s], see [Schulzrinne2003]_.
        offset_s: Our loop's time less the time since its boot [s].
        requests: How many requests `loss_out` is counted of.
    """

    loss_in: float
    loss_out: float
    delay_s: float
    jitter_s: float
    offset_s: float
    requests: int = 0

    def unfit(self) -> str | None:
        """Return in one line why no vehicle should be flown over such a link, with its figures; None: it may be.

        What is not known, because a vehicle does not answer TIMESYNC, is no reason.
        """
        reasons = []
        if self.loss_in > MOST_LOSS:
            reasons.append(f"{100 * self.loss_in:.0f} % of its frames are lost")
        if self.loss_out - SURE * self._loss_out_sigma > MOST_LOSS:
            reasons.append(f"{100 * self.loss_out:.0f} % of ours are lost on the way to it")
        if reasons:
            reasons[-1] += f" (most {100 * MOST_LOSS:.0f} %)"
        if self.delay_s > MOST_DELAY_S:
            reasons.append(f"the delay of one way is {self.delay_s:.2f} s (most {MOST_DELAY_S:g} s)")
        if self.jitter_s > MOST_JITTER_S:
            reasons.append(
                f"the delay changes by {self.jitter_s:.2f} s from one message to the next (most {MOST_JITTER_S:g} s)"
            )
        return ", ".join(reasons) or None

    @property
    def misses(self) -> float:
        """How many requests in a row remain without an answer, as good as never, while a vehicle hears us."""
        losses = (0.0 if math.isnan(loss) else min(loss, 0.9) for loss in (self.loss_in, self.loss_out))
        missed = 1.0 - math.prod(1.0 - loss for loss in losses)
        return math.log(RARE) / math.log(missed) if missed > 0.0 else 0.0

    @property
    def _loss_out_sigma(self) -> float:
        """Standard deviation of `loss_out` as an estimate, by the binomial distribution of the answers."""
        arriving = 1.0 - (0.0 if math.isnan(self.loss_in) else self.loss_in)
        answered = min(max((1.0 - self.loss_out) * arriving, 0.0), 1.0)
        return math.sqrt(answered * (1.0 - answered) / max(self.requests, 1)) / max(arriving, 0.01)


class BootClock:
    """The clock of one vehicle by the stamps of its samples, and their order.

    Attributes:
        offset_s: Our loop's time less the stamps [s], NaN before the first.
        jitter_s: Mean change of the delay from one sample to the next [s], NaN before the second.
        strays: Samples so far that fit neither the present boot nor, yet, another one.
    """

    def __init__(self) -> None:
        self.offset_s = math.nan
        self.jitter_s = math.nan
        self.strays = 0
        self._newest_s = math.nan  # stamp
        self._at_s = math.nan  # when that came
        self._least_s = math.inf  # of arrival less stamp
        self._least_in_s = self._least_out_s = math.inf  # of TIMESYNC's ways, by a clock that may be another one
        self._least_trip_s = math.inf
        self._apparent_s = math.nan  # arrival less stamp of the newest
        # Strays in a row: stamp and arrival of the first of them, stamp of the newest, and how many
        self._other: tuple[float, float, float, int] | None = None

    def stamped(self, stamp_s: float, now_s: float) -> float | None:
        """Take a sample; return the offset [s], or None for one that must not replace the newest: it is older.

        The same one may come again. After a restart stamps begin near zero and go on from there: the fifth sample that
        fits the four before it is believed.

        Args:
            stamp_s: Time since boot [s].
            now_s: Loop time [s].
        """
        if not 0.0 < stamp_s - self._newest_s <= now_s - self._at_s + MOST_AHEAD_S:
            if stamp_s == self._newest_s:
                return self.offset_s
            if not self._restarts(stamp_s, now_s):
                return None
        if self._other is not None:
            self._other = None
        apparent_s = now_s - stamp_s
        if apparent_s < self._least_s:
            self._least_s = apparent_s
            self._decide()
        change_s = abs(apparent_s - self._apparent_s)
        if change_s == change_s:
            self.jitter_s += (change_s - self.jitter_s) / 16.0
        else:
            self.jitter_s = 0.0
        self._newest_s, self._at_s, self._apparent_s = stamp_s, now_s, apparent_s
        return self.offset_s

    def answered(self, vehicle_s: float, sent_s: float, now_s: float) -> None:
        """Take an answer to TIMESYNC: the vehicle's time, when the request left, and when the answer came [s]."""
        self._least_in_s = min(self._least_in_s, now_s - vehicle_s)
        self._least_out_s = min(self._least_out_s, vehicle_s - sent_s)
        self._least_trip_s = min(self._least_trip_s, now_s - sent_s)
        if self._least_in_s + self._least_out_s < LEAST_SHARE * self._least_trip_s - SLACK_S:
            self._forget()
            self._least_in_s, self._least_out_s = now_s - vehicle_s, vehicle_s - sent_s
            self._least_trip_s = now_s - sent_s
        self._decide()

    def roll(self, passed_s: float) -> None:
        """Let what was learnt fade: its clock drifts. ``passed_s`` have passed since the last time [s]."""
        fade_s = DRIFT * passed_s
        self._least_s += fade_s
        self._least_in_s += fade_s
        self._least_out_s += fade_s
        self._least_trip_s += fade_s

    def _decide(self) -> None:
        delay_s = 0.5 * (self._least_in_s + self._least_out_s)
        known_s = max(delay_s, 0.0) if math.isfinite(delay_s) else 0.0
        self.offset_s = self._least_s - known_s if math.isfinite(self._least_s) else math.nan

    def _forget(self) -> None:
        self._least_s = self._least_in_s = self._least_out_s = self._least_trip_s = math.inf
        self._apparent_s = math.nan

    def _restarts(self, stamp_s: float, now_s: float) -> bool:
        """Tell whether a sample that does not follow the newest one begins the stamps anew."""
        if math.isnan(self._newest_s):
            return True
        if -MOST_LATE_S < stamp_s - self._newest_s <= 0.0:
            return False
        self.strays += 1
        first_s, at_s, latest_s, so_many = self._other or (stamp_s, now_s, -math.inf, 0)
        follows = stamp_s > latest_s and abs(stamp_s - first_s - (now_s - at_s)) < CONSISTENT_S
        self._other = (first_s, at_s, stamp_s, so_many + 1) if follows else (stamp_s, now_s, stamp_s, 1)
        restarted = stamp_s < min(self._newest_s, MOST_BOOT_S)
        if self._other[3] < (CONSISTENT if restarted else SURELY_CONSISTENT):
            return False
        self._forget()
        return True


class LinkTiming:
    """Loss, delay, jitter and clock of one vehicle's link; knows no clock itself.

    Attributes:
        sequence: Counts its frames: `SequenceCounter.add` for each of them.
        clock: Its clock by the stamps of its samples.
        heard_us_s: When the newest TIMESYNC request left that was answered: then it heard us; NaN before the first [s].
    """

    def __init__(self) -> None:
        self.sequence = SequenceCounter()
        self.clock = BootClock()
        self.heard_us_s = math.nan
        self._answers: deque[tuple[float, float]] = deque(maxlen=PACED)  # the vehicle's time, and ours [s]
        self._asked: dict[int, float] = {}  # requests under way: what they say [ns], and when they left [s]
        self._outcomes: deque[bool] = deque(maxlen=OUTCOMES)
        self._round_trips_s: deque[float] = deque(maxlen=ROUND_TRIPS)
        self._rolled_s = math.nan
        self._quality: LinkQuality | None = None  # None: to be worked out again
        self._strays: deque[int] = deque([0], maxlen=10)  # of the last five seconds

    def asked(self, said_ns: int, now_s: float) -> None:
        """Note that a TIMESYNC request has left, and what it says [ns]."""
        self._asked[said_ns] = now_s

    def answered(self, vehicle_ns: int, said_ns: int, now_s: float) -> None:
        """Take an answer; those to somebody else's requests, and doubled ones, say nothing.

        Args:
            vehicle_ns: The vehicle's time [ns].
            said_ns: What our request said [ns].
            now_s: Loop time [s].
        """
        sent_s = self._asked.pop(said_ns, None)
        if sent_s is None:
            return
        if not sent_s <= self.heard_us_s:
            self.heard_us_s = sent_s
        self._outcomes.append(True)
        if self._answers and vehicle_ns / 1e9 < self._answers[-1][0]:  # it has started again
            self._answers.clear()
        self._answers.append((vehicle_ns / 1e9, 0.5 * (sent_s + now_s)))
        self._round_trips_s.append(now_s - sent_s)
        self.clock.answered(vehicle_ns / 1e9, sent_s, now_s)

    def roll(self, now_s: float) -> None:
        """Let windows go on: call it about twice a second."""
        asked = self._asked  # the earliest first
        while asked and now_s - asked[first := next(iter(asked))] > ANSWER_S:
            del asked[first]
            self._outcomes.append(False)
        self.sequence.roll(now_s)
        if now_s > self._rolled_s:
            self.clock.roll(now_s - self._rolled_s)
        self._rolled_s = now_s
        self._quality = None
        self._strays.append(self.clock.strays)

    def pace(self, since_s: float = -math.inf) -> float:
        """Return how fast its clock goes, as a share of ours, by TIMESYNC; NaN while that is not known.

        A simulator that gets too little of a processor is slow: its vehicles then have less than they need.

        Args:
            since_s: What was answered before is not counted [s].
        """
        answers = [each for each in self._answers if each[1] >= since_s]
        if not answers or answers[-1][1] - answers[0][1] < PACE_S:
            return math.nan
        return (answers[-1][0] - answers[0][0]) / (answers[-1][1] - answers[0][1])

    @property
    def doubled(self) -> str | None:
        """Why two vehicles seem to speak under this one's id, in words for people; None: they do not."""
        if self.sequence.interleaved:
            return "their sequence numbers are interleaved"
        if self.clock.strays - self._strays[0] > 2 * CONSISTENT:
            return "their times since boot differ"
        return None

    @property
    def quality(self) -> LinkQuality:
        """How good the link was at the latest `roll`."""
        if self._quality is None:
            self._quality = self._measured()
        return self._quality

    def _measured(self) -> LinkQuality:
        loss_in, loss_out, delay_s = self.sequence.loss, math.nan, math.nan
        if self._round_trips_s:
            delay_s = 0.5 * sum(self._round_trips_s) / len(self._round_trips_s)
            answered = sum(self._outcomes) / len(self._outcomes)
            loss_out = min(max(1.0 - answered / max(1.0 - (0.0 if math.isnan(loss_in) else loss_in), 0.01), 0.0), 1.0)
        return LinkQuality(loss_in, loss_out, delay_s, self.clock.jitter_s, self.clock.offset_s, len(self._outcomes))
