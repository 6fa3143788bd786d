"""What went through a router."""

from typing import NamedTuple, Self


class Counters(NamedTuple):
    """What went through a router so far.

    Attributes:
        frames_in: Good frames, unknown messages included.
        frames_out: Frames sent.
        bad_bytes: Bytes that belonged to no good frame.
        unknown_messages: Frames whose message the dialect does not know.
        dropped: Frames not sent because the way out was full or closed.
        unroutable: Frames for a vehicle that was never heard.
        clashes: Frames ignored because their vehicle is already heard from elsewhere in its network.
        errors: Errors the system reported for our sockets.
        refused: Datagrams that were not read, or not to their end, because their sender sends too much, and those that
            the system has dropped before.
        unsigned: Frames not taken because they are not signed, in a network with a key.
        forged: Frames not taken because they are signed with another key.
        replayed: Frames not taken because their time stamp came before, or is too old.
        forwarded: Frames of vehicles passed on to other programs, see `fg_gcs.link.forwarding`.
        not_forwarded: Those that such a program missed, being slow or not there.
        commands_passed: What such programs said to vehicles and was passed on.
        commands_dropped: What was not.
    """

    frames_in: int
    frames_out: int
    bad_bytes: int
    unknown_messages: int
    dropped: int
    unroutable: int
    clashes: int
    errors: int
    refused: int
    unsigned: int
    forged: int
    replayed: int
    forwarded: int
    not_forwarded: int
    commands_passed: int
    commands_dropped: int

    @classmethod
    def none(cls) -> Self:
        """Return those of a router that never opened."""
        return cls(*[0] * len(cls._fields))
