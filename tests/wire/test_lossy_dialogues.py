"""The law of dialogues: on a link that loses 30 % each way and takes 150 ± 50 ms, no request fails or is too late."""

import heapq
import math
import random
from collections.abc import Callable
from itertools import pairwise

import pytest
from pymavlink.dialects.v20 import all as dialect

from fg_gcs.wire import commands
from fg_gcs.wire.address import MAIN, VehicleAddress
from fg_gcs.wire.autopilots import ARDUPILOT, PX4, AutopilotProfile
from fg_gcs.wire.codec import Codec, Message
from fg_gcs.wire.dialogue import DEADLINE_S, Exchange, Question, State
from fg_gcs.wire.framing import Sender
from fg_gcs.wire.params import encode
from fg_gcs.wire.reading import WORST_ANSWERED, ReadParameters, Wanted, is_unknown
from fg_gcs.wire.vehicle import Vehicle

STEP_S = 0.02
RUNS = 400  # of each request: some 3,000 in all
FIRST_S, LAST_S = 0.1, 0.2  # of the delay each way
WRONG = 1e-6  # chance that a request fails


class Obeying:
    """An autopilot that does what it is told, acknowledges it, and tells its state with every heartbeat."""

    def __init__(self, profile: AutopilotProfile) -> None:
        self.profile = profile
        self.mode, self.armed = 0, False
        self.parameters = {"KNOWN": 1.0, "FS_GCS_ENABLE": 0.0}
        self.intervals: dict[int, int] = {}
        self.refuses = False

    def heartbeat(self) -> Message:
        message: Message = dialect.MAVLink_heartbeat_message(
            2, self.profile.autopilot, 0x80 if self.armed else 0, self.mode, 3, 3
        )
        return message

    def answers(self, message: Message) -> list[Message]:
        if message.get_type() == "COMMAND_LONG":
            if self.refuses:
                return [dialect.MAVLink_command_ack_message(message.command, 4, 0, 0, 255, 190)]
            return [*self._do(message), dialect.MAVLink_command_ack_message(message.command, 0, 0, 0, 255, 190)]
        name = message.param_id
        if name not in self.parameters:
            return []
        if message.get_type() == "PARAM_SET":
            self.parameters[name] = message.param_value
        carried = encode(name, self.parameters[name], 9, self.profile.encoding)
        return [dialect.MAVLink_param_value_message(name.encode(), carried, 9, 1, 65535)]

    def _do(self, message: Message) -> list[Message]:
        match message.command:
            case dialect.MAV_CMD_COMPONENT_ARM_DISARM:
                self.armed = message.param1 == 1.0
            case dialect.MAV_CMD_DO_SET_MODE:
                self.mode = int(message.param2) << 16 | int(message.param3) << 24
                if self.profile is ARDUPILOT:
                    self.mode = int(message.param2)
            case dialect.MAV_CMD_NAV_LAND:
                self.mode = self.profile.land_mode
            case dialect.MAV_CMD_SET_MESSAGE_INTERVAL:
                self.intervals[int(message.param1)] = int(message.param2)
            case dialect.MAV_CMD_GET_MESSAGE_INTERVAL:
                number = int(message.param1)
                return [dialect.MAVLink_message_interval_message(number, self.intervals.get(number, 0))]
            case dialect.MAV_CMD_REQUEST_MESSAGE:
                return [dialect.MAVLink_gps_global_origin_message(473977428, 85455967, 489052)]
        return []


class Link:
    """Both ways between a dialogue and an autopilot, each datagram lost or late by itself."""

    def __init__(self, vehicle: Vehicle, autopilot: Obeying, draw: random.Random, loss: float) -> None:
        self.vehicle, self.autopilot = vehicle, autopilot
        self.now_s = 0.0
        self._draw, self._loss = draw, loss
        self._ours, self._theirs = Sender(), Sender(vehicle.system_id, 1)
        self._our_codec, self._their_codec = Codec(), Codec()
        self._under_way: list[tuple[float, int, bool, bytes]] = []
        self._count = 0

    def _send(self, data: bytes, *, to_vehicle: bool) -> None:
        self._count += 1
        if self._draw.random() >= self._loss:
            due_s = self.now_s + self._draw.uniform(FIRST_S, LAST_S)
            heapq.heappush(self._under_way, (due_s, self._count, to_vehicle, data))

    def ask(self, question: Question) -> Exchange:
        """Run a dialogue to its end."""
        dialogue = question.dialogue(self.vehicle)
        beat_s = self.now_s
        while dialogue.state is State.PENDING:
            for message in dialogue.step(self.now_s):
                self._send(self._ours.pack(message), to_vehicle=True)
            if self.now_s >= beat_s:
                beat_s += 0.2
                self._send(self._theirs.pack(self.autopilot.heartbeat()), to_vehicle=False)
            self.now_s += STEP_S
            while self._under_way and self._under_way[0][0] <= self.now_s:
                due_s, _, to_vehicle, data = heapq.heappop(self._under_way)
                if to_vehicle:
                    (message,) = self._their_codec.receive(data)
                    for answer in self.autopilot.answers(message):
                        self._send(self._theirs.pack(answer), to_vehicle=False)
                else:
                    (frame,) = self._our_codec.receive(data)
                    self.vehicle.handle(frame, due_s)
        return dialogue


def wanted(*names: str) -> ReadParameters:
    return ReadParameters(tuple(Wanted((name,), needed=True) for name in names))


QUESTIONS: dict[str, Callable[[Vehicle], Question]] = {
    "arm": lambda vehicle: commands.arm(),
    "disarm": lambda vehicle: commands.disarm(),
    "mode": lambda vehicle: commands.set_mode(vehicle.profile.streaming_mode),
    "land": lambda vehicle: commands.land(),
    "origin": lambda vehicle: commands.request_origin(),
    "stream": lambda vehicle: commands.set_message_interval(32, 25.0, optional=False),
    "read": lambda vehicle: wanted("KNOWN", "FS_GCS_ENABLE"),
    "write": lambda vehicle: commands.write_parameter("FS_GCS_ENABLE", 5.0),
}


@pytest.mark.parametrize("loss", [0.0, 0.3])
@pytest.mark.parametrize("kind", QUESTIONS)
def test_no_request_fails_for_losses_and_delay(kind: str, loss: float) -> None:
    took_s = []
    for seed in range(RUNS):
        profile = (PX4, ARDUPILOT)[seed % 2]
        vehicle, autopilot = Vehicle(VehicleAddress(MAIN, 4), profile, 0.0), Obeying(profile)
        autopilot.armed = vehicle.armed = kind in ("disarm", "land")
        link = Link(vehicle, autopilot, random.Random(seed), loss)
        dialogue = link.ask(QUESTIONS[kind](vehicle))
        assert dialogue.state is State.DONE, dialogue.reason
        took_s.append(link.now_s)
    assert max(took_s) < DEADLINE_S / (1.0 if loss else 8.0)


def test_there_is_time_for_so_many_questions_that_practically_none_fails() -> None:
    vehicle = Vehicle(VehicleAddress(MAIN, 4), ARDUPILOT, 0.0)
    dialogue = commands.write_parameter("FS_GCS_ENABLE", 5.0).dialogue(vehicle)
    asked_s = [k * STEP_S for k in range(round(DEADLINE_S / STEP_S)) if dialogue.step(k * STEP_S)]
    in_time = sum(at_s + 2.0 * LAST_S < DEADLINE_S for at_s in asked_s)
    assert (1.0 - WORST_ANSWERED) ** in_time < WRONG
    assert all(0.3 - 1e-9 <= later_s - earlier_s < 0.6 for earlier_s, later_s in pairwise(asked_s))


def test_a_whole_dialogue_in_any_order_of_late_answers() -> None:
    """Requests of one kind follow each other at once: none takes the answer to the one before for its own."""
    for seed in range(40):
        vehicle, autopilot = Vehicle(VehicleAddress(MAIN, 4), PX4, 0.0), Obeying(PX4)
        link = Link(vehicle, autopilot, random.Random(seed), 0.2)
        rates = {32: 25.0, 30: 10.0, 245: 5.0, 31: -1.0}
        for message_id, rate_hz in rates.items():
            assert link.ask(commands.set_message_interval(message_id, rate_hz, optional=False)).state is State.DONE
            interval_us = autopilot.intervals.get(message_id, 0)
            assert interval_us == round(1e6 / rate_hz) if rate_hz > 0.0 else interval_us <= 0
        for mode in (PX4.modes["LOITER"], PX4.streaming_mode, PX4.land_mode):
            assert link.ask(commands.set_mode(mode)).state is State.DONE
            assert autopilot.mode == mode
        for question, armed in ((commands.arm(), True), (commands.disarm(), False), (commands.arm(), True)):
            assert link.ask(question).state is State.DONE
            assert autopilot.armed == armed


def test_a_refusal_is_told_soon_and_its_late_copies_end_no_other_request() -> None:
    for seed in range(100):
        vehicle, autopilot = Vehicle(VehicleAddress(MAIN, 4), ARDUPILOT, 0.0), Obeying(ARDUPILOT)
        link = Link(vehicle, autopilot, random.Random(seed), 0.0)
        autopilot.refuses = True
        dialogue = link.ask(commands.arm())
        assert dialogue.reason == "vehicle 4 did not arm: failed"
        assert link.now_s < 1.5
        autopilot.refuses = False
        assert link.ask(commands.arm()).state is State.DONE
        assert autopilot.armed


@pytest.mark.parametrize("loss", [0.0, 0.2, 0.3])
def test_an_unknown_parameter_is_told_from_a_lost_answer(loss: float) -> None:
    for seed in range(60):
        vehicle, autopilot = Vehicle(VehicleAddress(MAIN, 4), ARDUPILOT, 0.0), Obeying(ARDUPILOT)
        link = Link(vehicle, autopilot, random.Random(seed), loss)
        question = ReadParameters((Wanted(("KNOWN",), needed=True), Wanted(("NONE", "OTHER"), needed=False)))
        dialogue = link.ask(question)
        assert dialogue.state is State.DONE, dialogue.reason
        assert "KNOWN" in vehicle.params
        assert link.now_s < (6.0 if loss == 0.0 else 15.0)


def test_a_known_parameter_is_practically_never_taken_for_an_unknown_one() -> None:
    """By the exact probabilities of all ways to get there: n rounds, m answers about the other, none about this one."""
    for answered in (WORST_ANSWERED, 0.6, 0.8, 0.9, 0.99):
        undecided, wrong = {0: 1.0}, 0.0  # probability by the answers heard so far, this one never among them
        for asked in range(1, 101):
            after: dict[int, float] = {}
            for heard, chance in undecided.items():
                for more, share in ((0, 1.0 - answered), (1, answered)):
                    after[heard + more] = after.get(heard + more, 0.0) + chance * share * (1.0 - answered)
            wrong += math.fsum(chance for heard, chance in after.items() if is_unknown(asked, heard))
            undecided = {heard: chance for heard, chance in after.items() if not is_unknown(asked, heard)}
        assert wrong < WRONG, answered
