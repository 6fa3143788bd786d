"""The order in which frames left their sender, told by their sequence numbers; what comes twice is dropped.

A datagram may come late, twice, or not at all. MAVLink numbers the frames of a sender modulo 256 on each link, which is
enough to tell these apart while fewer frames are lost in a row than half of that, and to notice when it is not.
"""

from collections.abc import Sequence
from typing import Final

from fg_gcs.wire.codec import Frame

AHEAD: Final = 32  # a frame this far ahead of the newest one follows it, those between are lost or late
BEHIND: Final = 64  # and one this far behind is late, or comes a second time
QUIET_S: Final = 0.5  # longer than frames overtake each other: what is behind after such a silence is no late frame
CONFIRM_S: Final = 0.1  # several frames share a datagram, so those that confirm each other must be this far apart
_MOST_HELD: Final = 64
_NUMBERS: Final = 256

Placed = tuple[int, Frame]


class FrameOrder:
    """Places the frames of one sender: each gets an index that grows by one with every frame that was sent.

    A frame that fits nowhere near the newest one is from the past, or others before it were lost by the dozen, or its
    sender has started again. It is held until the next frames tell: if they go on from the newest one it was from the
    past and is dropped; if for `CONFIRM_S` they go on from the held one, all that were held are given out.
    """

    def __init__(self) -> None:
        self._newest = -1  # index; its last eight bits are the sequence number
        self._newest_at_s = 0.0
        self._indices = [-1] * _NUMBERS  # by sequence number, as the checksums: what came under it last
        self._checksums = [b""] * _NUMBERS
        self._held: list[Frame] = []
        self._held_since_s = 0.0

    def place(self, frame: Frame, now_s: float) -> Sequence[Placed]:
        """Return the frames that can be believed now with their indices, in the order of their arrival.

        Args:
            frame: The next frame that came from the sender.
            now_s: Loop time [s].
        """
        sequence, newest = frame.get_seq(), self._newest
        if newest < 0:
            return (self._accept(frame, sequence, now_s),)
        ahead = (sequence - newest) % _NUMBERS
        if 0 < ahead <= AHEAD:
            self._held.clear()
            return (self._accept(frame, newest + ahead, now_s),)
        behind = -ahead % _NUMBERS
        if behind <= BEHIND:
            index = newest - behind
            if self._indices[sequence] == index:
                if self._checksums[sequence] == frame.raw[-2:]:
                    return ()
            elif index >= 0 and now_s - self._newest_at_s <= QUIET_S:
                self._held.clear()
                return (self._accept(frame, index, now_s),)
        return self._hold(frame, now_s)

    def _accept(self, frame: Frame, index: int, now_s: float) -> Placed:
        sequence = index % _NUMBERS
        self._indices[sequence], self._checksums[sequence] = index, frame.raw[-2:]
        if index > self._newest:
            self._newest, self._newest_at_s = index, now_s
        return index, frame

    def _hold(self, frame: Frame, now_s: float) -> Sequence[Placed]:
        held = self._held
        if not held or not _follows(held[-1], frame) or len(held) >= _MOST_HELD:
            self._held, self._held_since_s = [frame], now_s
            return ()
        held.append(frame)
        if now_s - self._held_since_s < CONFIRM_S:
            return ()
        self._held = []
        # Whole turns further on, so that everything is newer than whatever came before
        base = self._newest + 2 * _NUMBERS
        first = base + (held[0].get_seq() - base) % _NUMBERS
        return [
            self._accept(one, first + _signed(one.get_seq() - held[0].get_seq()), now_s)
            for one in sorted(held, key=lambda one: _signed(one.get_seq() - held[0].get_seq()))
        ]


def _follows(before: Frame, frame: Frame) -> bool:
    """Tell whether two frames can be neighbours on one link; the same frame twice confirms nothing."""
    return before.raw != frame.raw and -AHEAD <= _signed(frame.get_seq() - before.get_seq()) <= AHEAD


def _signed(difference: int) -> int:
    return (difference + _NUMBERS // 2) % _NUMBERS - _NUMBERS // 2
