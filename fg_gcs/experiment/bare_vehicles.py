"""Bare vehicles for benchmarks: a process that sends frames made beforehand and counts what comes, and nothing else.

It reads JSON lines: the first says what to play, ``{"position_hz": F}`` changes a rate, ``{}`` asks for the counts;
after the first line it answers each with one. The end of its input ends it. It needs the standard library alone, so
that it is there at once and takes little of a core beside what is measured.
"""

from __future__ import annotations

import json
import resource
import selectors
import socket
import sys
import time
from typing import Final

TICK_S: Final = 0.01
BOOT_S: Final = 3.0  # while it tells origins, so that frames can be learnt
SETPOINT_ID: Final = 84
# Of a MAVLink 2 frame of SET_POSITION_TARGET_LOCAL_NED, whose payload is never shortened
SENDER_AT: Final = 5
ID_AT: Final = 7
TARGET_AT: Final = 60
LENGTH: Final = 65
BARE_LOOP: Final = 254  # setpoints of this sender are not counted: see `fg_gcs.experiment.baselines.ground_stations`


class BareVehicles:
    """Plays vehicles, each on a socket of its own.

    Attributes:
        right: setpoints that reached the vehicle that they are for.
        wrong: setpoints that reached another one.
    """

    def __init__(self, told: dict[str, object]) -> None:
        """Take what the first line says, see `fg_gcs.experiment.bare_process`."""
        vehicles = told["vehicles"]
        assert isinstance(vehicles, list), "a list of objects"
        self.right = self.wrong = 0
        self.position_hz = float(str(told["position_hz"]))
        self.selector = selectors.DefaultSelector()
        self.sockets = [socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in vehicles]
        self._remotes = [tuple(each["remote"]) for each in vehicles]
        self._frames = [
            [bytes.fromhex(each[name]) for name in ("heartbeat", "origin", "position")] for each in vehicles
        ]
        for own, each in zip(self.sockets, vehicles, strict=True):
            own.setblocking(False)
            own.bind(("127.0.0.1", 0))
            self.selector.register(own, selectors.EVENT_READ, each["system_id"])
        self._done = {"heartbeat": 0.0, "position": 0.0}  # frames that should have left so far, by kind

    def speak(self, passed_s: float, since_start_s: float) -> None:
        """Send what is due: each kind of frame evenly spread over the vehicles and the time."""
        for kind, rate_hz in (("heartbeat", 1.0), ("position", self.position_hz)):
            before = int(self._done[kind])
            self._done[kind] += passed_s * rate_hz * len(self.sockets)
            for count in range(before, int(self._done[kind])):
                place = count % len(self.sockets)
                heartbeat, origin, position = self._frames[place]
                self._send(place, heartbeat if kind == "heartbeat" else position)
                if kind == "heartbeat" and since_start_s < BOOT_S:
                    self._send(place, origin)

    def hear(self, own: socket.socket, system_id: int) -> None:
        """Count all that waits at a socket."""
        try:
            while True:
                data = own.recv(2048)
                if len(data) == LENGTH and data[ID_AT] == SETPOINT_ID and data[SENDER_AT] != BARE_LOOP:
                    if data[TARGET_AT] == system_id:
                        self.right += 1
                    else:
                        self.wrong += 1
        except OSError:  # nothing more, or the ground station is not there yet
            return

    def _send(self, place: int, data: bytes) -> None:
        try:
            self.sockets[place].sendto(data, self._remotes[place])
        except OSError:  # a full way out loses a frame, as everywhere
            return


def main() -> None:
    """Play until the input ends."""
    _, most = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (most, most))  # a socket a vehicle
    played = BareVehicles(json.loads(sys.stdin.readline()))
    _tell({"ports": [own.getsockname()[1] for own in played.sockets]})
    played.selector.register(sys.stdin.fileno(), selectors.EVENT_READ, None)
    start_s = last_s = time.monotonic()
    while True:
        for key, _ in played.selector.select(max(0.0, last_s + TICK_S - time.monotonic())):
            if isinstance(key.fileobj, socket.socket):
                played.hear(key.fileobj, key.data)
                continue
            line = sys.stdin.readline()  # one at a time: each is answered before the next is written
            if not line:
                return
            played.position_hz = json.loads(line).get("position_hz", played.position_hz)
            _tell({"right": played.right, "wrong": played.wrong})
        now_s = time.monotonic()
        if now_s - last_s >= TICK_S:
            played.speak(now_s - last_s, now_s - start_s)
            last_s = now_s


def _tell(answer: dict[str, object]) -> None:
    sys.stdout.write(json.dumps(answer) + "\n")
    sys.stdout.flush()


if __name__ == "__main__":
    main()
