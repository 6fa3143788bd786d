"""STATUSTEXT put together: long texts come in chunks of 50 characters, PX4 ends each text with a tab."""

from typing import Final, NamedTuple

from fg_gcs.wire.codec import Message

_CHUNK: Final = 50  # characters of one STATUSTEXT; a shorter chunk is the last one
_LONGEST: Final = 10  # chunks kept of one text: 500 characters are enough for any autopilot, not for an attacker
_PATIENCE_S: Final = 0.5  # PX4 sends at most 20 texts a second, the chunks of one text come within milliseconds


class Text(NamedTuple):
    """A whole status text.

    Attributes:
        severity: MAV_SEVERITY, 0 (emergency) to 7 (debug).
        text: The text, stripped.
        at_s: Loop time of its first chunk [s].
    """

    severity: int
    text: str
    at_s: float


class TextAssembler:
    """Puts the chunks of one vehicle's status texts together."""

    def __init__(self) -> None:
        self._identity = 0
        self._chunks: dict[int, str] = {}
        self._severity = 0
        self._began_s = 0.0

    def add(self, message: Message, now_s: float) -> list[Text]:
        """Take one STATUSTEXT and return the texts that are whole now, lost chunks shown as an ellipsis.

        MAVLink keeps id 0 for texts in one piece, yet PX4's first long text after boot has it: a full chunk waits for
        another one whatever its id.
        """
        done = self.flush() if message.id != self._identity or message.chunk_seq in self._chunks else []
        if not self._chunks:
            self._identity, self._severity, self._began_s = message.id, message.severity, now_s
        self._chunks[message.chunk_seq] = message.text
        if len(message.text) < _CHUNK or len(self._chunks) >= _LONGEST:
            done += self.flush()
        return done

    def flush_stale(self, now_s: float) -> list[Text]:
        """Return the unfinished text if its rest has not come for `_PATIENCE_S`."""
        return self.flush() if self._chunks and now_s - self._began_s > _PATIENCE_S else []

    def flush(self) -> list[Text]:
        """Return what there is of an unfinished text."""
        chunks, self._chunks = self._chunks, {}
        if not chunks:
            return []
        numbers = range(min(max(chunks), _LONGEST) + 1)
        return _whole(self._severity, "".join(chunks.get(number, "…") for number in numbers), self._began_s)


def _whole(severity: int, text: str, at_s: float) -> list[Text]:
    stripped = text.strip("\t\n\r \0")
    return [Text(severity, stripped, at_s)] if stripped else []
