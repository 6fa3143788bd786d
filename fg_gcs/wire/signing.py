"""MAVLink 2 signing: what our frames are signed with, and which frames are taken; knows no clock and no file.

By the protocol's own guide (https://mavlink.io/en/guide/message_signing.html): a signature is the first 48 bits of
SHA-256 over key, frame, link id and time stamp; the stamps of one sender on one link never run back, and the first one
of a sender is at most a minute behind the newest stamp of all. Where the guide refuses every stamp that is not newer
than the last, ours are refused only if they came before: a link that reorders frames is no attack.
"""

import hashlib
import hmac
from collections.abc import Callable
from enum import Enum
from typing import Final

from pymavlink.dialects.v20 import all as dialect

from fg_gcs.wire.codec import MAGIC_V2, SIGNATURE_BYTES, SIGNED, Frame, Message

KEY_BYTES: Final = 32
LINK_IDS: Final = 256  # a link's number is one byte
EPOCH_UNIX_S: Final = 1_420_070_400  # 2015-01-01, from where stamps count
UNITS_PER_S: Final = 100_000  # a stamp counts 10 us
NEW_STREAM_UNITS: Final = 60 * UNITS_PER_S  # so far behind the newest stamp of all a sender may begin, by the guide
REORDERED: Final = 256  # of a stream's newest stamps so many at least are known one by one; older ones are refused
SETUP_SIGNING: Final[int] = dialect.MAVLINK_MSG_ID_SETUP_SIGNING
RADIO_STATUS: Final[int] = dialect.MAVLINK_MSG_ID_RADIO_STATUS

_MOST_STAMP: Final = (1 << 48) - 1  # in the year 2104
_MOST_HEARD: Final = _MOST_STAMP - 366 * 86_400 * UNITS_PER_S  # a broken clock must not lead ours to where none is left
_DIGEST_BYTES: Final = 6
_STAMP_BYTES: Final = 6
_AUTOPILOT: Final[int] = dialect.MAV_COMP_ID_AUTOPILOT1


class Refusal(Enum):
    """Why a frame is not taken, in the words that follow "is" or "are"."""

    UNSIGNED = "not signed"
    FORGED = "signed with another key"
    REPLAYED = "a repetition, or too old"


def stamp_of(unix_s: float) -> int:
    """Return the stamp of a time [s since 1970]; 0 of times before 2015."""
    return min(max(int((unix_s - EPOCH_UNIX_S) * UNITS_PER_S), 0), _MOST_STAMP)


class Stamps:
    """The time that our frames are signed with: goes with a clock, never runs back, and is never behind others' stamps.

    Args:
        clock: Any clock that never runs back [s].
        start: The stamp of now: that of the wall clock, or one that was used before if that is later.
    """

    def __init__(self, clock: Callable[[], float], start: int) -> None:
        start = min(start, _MOST_HEARD)
        self._clock = clock
        self._ahead = start - int(clock() * UNITS_PER_S)  # of the clock
        self._newest = start

    def take(self) -> int:
        """Return a stamp that is later than any before."""
        now = self._ahead + int(self._clock() * UNITS_PER_S)
        newest = self._newest
        self._newest = newest = now if now > newest else newest + 1
        return newest

    def hear(self, stamp: int) -> None:
        """Take a good stamp of somebody else: if that clock is ahead, ours goes on from there."""
        now, stamp = self.now(), min(stamp, _MOST_HEARD)
        if stamp > now:
            self._ahead += stamp - now
            self._newest = stamp

    def now(self) -> int:
        """Return the stamp of now, which is never earlier than one that was taken, or heard."""
        return max(self._ahead + int(self._clock() * UNITS_PER_S), self._newest)


class Signature:
    """Signs what leaves on one link.

    Args:
        key: `KEY_BYTES` bytes.
        link_id: 0 to 255; tells our links apart.
        stamps: Of all links.
    """

    def __init__(self, key: bytes, link_id: int, stamps: Stamps) -> None:
        self._begun = hashlib.sha256(key)  # copied for every frame: the key is hashed once
        self._link = bytes([link_id])
        self._take = stamps.take

    def of(self, frame: bytes) -> bytes:
        """Return what follows a frame: link id, stamp and signature.

        Args:
            frame: From its magic byte to its checksum, with the flag that says that it is signed.
        """
        tail = self._link + self._take().to_bytes(_STAMP_BYTES, "little")
        digest = self._begun.copy()
        digest.update(frame)
        digest.update(tail)
        return tail + digest.digest()[:_DIGEST_BYTES]


class Stream:
    """The stamps of one sender on one link: each is good once.

    Stamps that are older than the newest are good if they are known not to have come before: the newest `REORDERED`
    are known one by one, at least, as far as they are not more than a minute behind the newest.

    Args:
        oldest: Stamps up to here are too old from the beginning.
    """

    __slots__ = ("_floor", "_newest", "_seen")

    def __init__(self, oldest: int) -> None:
        self._seen: set[int] = set()
        self._floor = self._newest = oldest

    def add(self, stamp: int) -> bool:
        """Take a stamp; tell whether it is good."""
        seen = self._seen
        if stamp > self._newest:
            self._newest = stamp
        elif stamp <= self._floor or stamp in seen or stamp <= self._newest - NEW_STREAM_UNITS:
            return False
        seen.add(stamp)
        if len(seen) >= 2 * REORDERED:
            newest = sorted(seen)[-REORDERED:]
            self._floor, self._seen = newest[0] - 1, set(newest)
        return True


class Signing:
    """What a network signs with, and the judge of the frames that come in it.

    Args:
        key: `KEY_BYTES` bytes, which all vehicles of the network have.
        stamps: Of all our links, in whatever networks.
        sets_up: The vehicles do not have the key yet: those that do not sign are heard until `rely`.

    Attributes:
        key: As given.
        sets_up: As given, until the key is relied on.
        counts: Frames refused so far, by the reason.
        signed: System ids of autopilots that have sent a good signature.
    """

    def __init__(self, key: bytes, stamps: Stamps, *, sets_up: bool = False) -> None:
        self.key = key
        self.sets_up = sets_up
        self.counts = dict.fromkeys(Refusal, 0)
        self.signed: set[int] = set()
        self._stamps = stamps
        self._begun = hashlib.sha256(key)
        self._streams: dict[tuple[int, int, int], Stream] = {}  # only who has the key can make one

    def signature(self, link_id: int) -> Signature:
        """Return what signs the frames of one of our links."""
        return Signature(self.key, link_id, self._stamps)

    def refusal(self, frame: Frame) -> Refusal | None:
        """Judge a good frame; return why it is not taken, None: it is."""
        refusal = self._judge(frame)
        if refusal is not None:
            self.counts[refusal] += 1
        return refusal

    def rely(self) -> None:
        """Let nobody be heard any more who does not sign."""
        self.sets_up = False

    def set_up(self, system_id: int) -> Message:
        """Return the message that gives a vehicle the key. Whoever overhears it has the key, too."""
        message: Message = dialect.MAVLink_setup_signing_message(
            system_id, _AUTOPILOT, list(self.key), self._stamps.now()
        )
        return message

    def _judge(self, frame: Frame) -> Refusal | None:
        raw = frame.raw
        if raw[0] != MAGIC_V2 or not raw[2] & SIGNED:
            if self.sets_up and frame.system_id not in self.signed:
                return None
            # A radio, which has no key, tells of its link; what flies never depends on it
            is_radio = frame.message_id == RADIO_STATUS and frame.component_id != _AUTOPILOT
            return None if is_radio else Refusal.UNSIGNED
        digest = self._begun.copy()
        digest.update(raw[:-_DIGEST_BYTES])
        if not hmac.compare_digest(digest.digest()[:_DIGEST_BYTES], raw[-_DIGEST_BYTES:]):
            return Refusal.FORGED
        stamp = int.from_bytes(raw[-_DIGEST_BYTES - _STAMP_BYTES : -_DIGEST_BYTES], "little")
        sender = raw[-SIGNATURE_BYTES], frame.system_id, frame.component_id
        stream = self._streams.get(sender)
        if stream is None:
            oldest = self._stamps.now() - NEW_STREAM_UNITS
            if stamp <= oldest:
                return Refusal.REPLAYED
            stream = self._streams[sender] = Stream(oldest)
        if not stream.add(stamp):
            return Refusal.REPLAYED
        self._stamps.hear(stamp)
        if frame.component_id == _AUTOPILOT:  # and not what flies with it
            self.signed.add(frame.system_id)
        return None
