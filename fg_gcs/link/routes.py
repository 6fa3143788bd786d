"""The ways to vehicles, for frames that leave together."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from fg_gcs.link.endpoint import Wire
from fg_gcs.link.peers import Peer
from fg_gcs.wire.framing import Frames, Sender


class Round(NamedTuple):
    """What leaves at one wire.

    Attributes:
        places: Those of its vehicles among all addresses; None: all of them.
        is_shorter: Its frames are not signed while others of the round are.
        send: What sends to them.
    """

    places: NDArray[np.int_] | None
    is_shorter: bool
    send: Callable[[Frames], None]


@dataclass(frozen=True, slots=True)
class Routes:
    """The ways to some vehicles, each to where its vehicle was heard.

    Attributes:
        peers: Where they lead.
        senders: What numbers the frames to each of them; for `fg_gcs.wire.setpoint.SetpointRound`.
        rounds: One for each wire.
    """

    peers: Sequence[Peer]
    senders: list[Sender]
    rounds: Sequence[Round]

    @classmethod
    def of(cls, peers: Sequence[Peer]) -> Self:
        """Return the ways to these peers."""
        by_wire: dict[Wire, list[int]] = {}
        for place, peer in enumerate(peers):
            by_wire.setdefault(peer.wire, []).append(place)
        senders = [peer.sender for peer in peers]
        signed = {sender.signature is not None for sender in senders}
        rounds = [
            Round(
                None if len(by_wire) == 1 else np.array(places),
                len(signed) > 1 and senders[places[0]].signature is None,
                wire.round_to([peers[place].address for place in places]),
            )
            for wire, places in by_wire.items()
        ]
        return cls(peers, senders, rounds)
