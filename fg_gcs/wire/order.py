"""The order in which frames left their sender, told by their sequence numbers; what comes twice is dropped.

A datagram may come late, twice, or not at all. MAVLink numbers the frames of a sender modulo 256 on each link, which is
enough to tell these apart while fewer frames are lost in a row than half of that, and to notice when it is not. It is
not enough where everything comes a second time just as long later as 256 frames take, three seconds of PX4's: numbers
alone cannot tell the second from the first then.
"""

from collections.abc import Sequence
from typing import Final

from fg_gcs.wire.codec import MAGIC_V2, Frame

NEAR: Final = 8  # a frame this far ahead of the newest one follows it: those between are lost, or were overtaken
AHEAD: Final = 32  # and as far as this, if there was time for so many
FASTEST_HZ: Final = 500.0  # more frames a second no vehicle sends; PX4 begins with 370
BEHIND: Final = 64  # and one this far behind is late, or comes a second time
QUIET_S: Final = 0.5  # longer than frames overtake each other: what is behind after such a silence is no late frame
CONFIRM_S: Final = 0.1  # several frames share a datagram, so those that confirm each other must be this far apart
_MOST_HELD: Final = 64
_NUMBERS: Final = 256

NOT_NOW: Final = -1


class FrameOrder:
    """Places the frames of one sender: each gets an index that grows by one with every frame that was sent.

    A frame that fits nowhere near the newest one is from the past, or others before it were lost by the dozen, or its
    sender has started again. It is held until the next frames tell: if they go on from the newest one it was from the
    past and is dropped; if for `CONFIRM_S` they go on from the held one, all that were held are released.
    """

    def __init__(self) -> None:
        self._newest = -1  # index; its last eight bits are the sequence number
        self._placed_at_s = 0.0  # when a frame, the newest or a late one, was placed last
        self._indices = [-1] * _NUMBERS  # by sequence number, as the checksums: what came under it last
        self._checksums = [b""] * _NUMBERS
        self._held: list[Frame] = []
        self._held_since_s = 0.0
        self._released: list[tuple[Frame, int]] = []

    def place(self, frame: Frame, now_s: float) -> int:
        """Return the index of a frame, or `NOT_NOW`: it is dropped, or held, or among those now `released`.

        Args:
            frame: The next frame that came from the sender.
            now_s: Loop time [s].
        """
        raw, newest = frame.raw, self._newest
        sequence = raw[4] if raw[0] == MAGIC_V2 else raw[2]  # as `Frame.get_seq`, at thousands of frames a second
        ahead = (sequence - newest) & 0xFF
        if 0 < ahead <= NEAR and newest >= 0:
            if self._held:
                self._held.clear()
            self._newest = newest = newest + ahead
            self._placed_at_s = now_s
            self._indices[sequence], self._checksums[sequence] = newest, raw[-2:]
            return newest
        return self._place_elsewhere(frame, sequence, now_s)

    def released(self) -> Sequence[tuple[Frame, int]]:
        """Take out the frames that were held and can be believed now, with their indices, in the order of these."""
        released, self._released = self._released, []
        return released

    def _place_elsewhere(self, frame: Frame, sequence: int, now_s: float) -> int:
        if self._newest < 0:
            return self._accept(frame, sequence, now_s)
        ahead = (sequence - self._newest) % _NUMBERS
        if 0 < ahead <= min(AHEAD, NEAR + FASTEST_HZ * (now_s - self._placed_at_s)):
            self._held.clear()
            return self._accept(frame, self._newest + ahead, now_s)
        behind = (self._newest - sequence) % _NUMBERS
        if behind <= BEHIND:
            index = self._newest - behind
            if self._indices[sequence] == index:
                if self._checksums[sequence] == frame.raw[-2:]:
                    return NOT_NOW
            elif index >= 0 and now_s - self._placed_at_s <= QUIET_S:
                self._held.clear()
                return self._accept(frame, index, now_s)
        self._hold(frame, now_s)
        return NOT_NOW

    def _accept(self, frame: Frame, index: int, now_s: float) -> int:
        sequence = index % _NUMBERS
        self._indices[sequence], self._checksums[sequence] = index, frame.raw[-2:]
        self._newest, self._placed_at_s = max(self._newest, index), now_s
        return index

    def _hold(self, frame: Frame, now_s: float) -> None:
        held = self._held
        if not held or not _follows(held[-1], frame) or len(held) >= _MOST_HELD:
            self._held, self._held_since_s = [frame], now_s
            return
        held.append(frame)
        if now_s - self._held_since_s < CONFIRM_S:
            return
        self._held = []
        base = self._newest + 2 * _NUMBERS  # whole turns further on, so that all is newer than whatever came before
        first, start = held[0].get_seq(), base + (held[0].get_seq() - base) % _NUMBERS
        steps = sorted((_signed(one.get_seq() - first), place) for place, one in enumerate(held))
        self._released = [(held[place], self._accept(held[place], start + step, now_s)) for step, place in steps]


def _follows(before: Frame, frame: Frame) -> bool:
    """Tell whether two frames can be neighbours on one link; the same frame twice confirms nothing."""
    return before.raw != frame.raw and -AHEAD <= _signed(frame.get_seq() - before.get_seq()) <= AHEAD


def _signed(difference: int) -> int:
    return (difference + _NUMBERS // 2) % _NUMBERS - _NUMBERS // 2
