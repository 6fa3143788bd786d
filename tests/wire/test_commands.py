import math
from collections.abc import Callable

import pytest
from pymavlink.dialects.v20 import all as dialect

from fg_gcs.errors import VehicleError
from fg_gcs.wire import commands
from fg_gcs.wire.address import MAIN, VehicleAddress
from fg_gcs.wire.autopilots import ARDUPILOT, PX4, AutopilotProfile
from fg_gcs.wire.codec import Codec, Message
from fg_gcs.wire.dialogue import DEADLINE_S, TEMPORARY_S, Dialogue, Exchange, Question, Request, State
from fg_gcs.wire.framing import Sender
from fg_gcs.wire.params import Encoding, encode
from fg_gcs.wire.reading import ReadParameters, Wanted
from fg_gcs.wire.vehicle import Vehicle

STEP_S = 0.02
Answer = Callable[[Message, float], list[tuple[float, Message]]]


def ack(command: int, result: int) -> Message:
    message: Message = dialect.MAVLink_command_ack_message(command, result, 0, 0, 255, 190)
    return message


def beat(profile: AutopilotProfile, mode: int, *, armed: bool = False) -> Message:
    message: Message = dialect.MAVLink_heartbeat_message(2, profile.autopilot, 0x80 if armed else 0, mode, 3, 3)
    return message


def silent(message: Message, now_s: float) -> list[tuple[float, Message]]:
    return []


def reading(*names: str, needed: bool = True) -> ReadParameters:
    return ReadParameters((Wanted(names, needed),))


def run(vehicle: Vehicle, question: Question, answer: Answer) -> tuple[Exchange, list[Message], float]:
    """Run a dialogue against ``answer``, which gives (delay, message) for each message it gets."""
    dialogue, sent, now_s = question.dialogue(vehicle), list[Message](), 0.0
    ours, theirs, our_codec, their_codec = Sender(), Sender(vehicle.system_id, 1), Codec(), Codec()
    due: list[tuple[float, Message]] = []
    while dialogue.state is State.PENDING:
        for out in dialogue.step(now_s):
            (received,) = their_codec.receive(ours.pack(out))
            sent.append(received)
            due += [(now_s + delay, message) for delay, message in answer(received, now_s)]
        now_s += STEP_S
        for message in [message for at_s, message in due if now_s - STEP_S < at_s <= now_s]:
            for heard in our_codec.receive(theirs.pack(message)):
                vehicle.handle(heard, now_s)
        assert now_s < 1000.0
    return dialogue, sent, now_s


def px4() -> Vehicle:
    return Vehicle(VehicleAddress(MAIN, 3), PX4, 0.0)


def ardupilot() -> Vehicle:
    return Vehicle(VehicleAddress(MAIN, 4), ARDUPILOT, 0.0)


def test_arming_is_done_when_the_heartbeat_says_so_not_when_it_is_acknowledged() -> None:
    def answer(message: Message, now_s: float) -> list[tuple[float, Message]]:
        return [(0.01, ack(400, 0)), (0.9, beat(ARDUPILOT, 4, armed=True))]

    dialogue, sent, ended_s = run(ardupilot(), commands.arm(), answer)
    assert dialogue.state is State.DONE
    assert 0.9 < ended_s < 1.0
    assert {(m.command, m.param1, m.target_system, m.target_component) for m in sent} == {(400, 1.0, 4, 1)}


@pytest.mark.parametrize("result", [2, 3, 4])
def test_a_refusal_brings_its_reason_along(result: int) -> None:
    def answer(message: Message, now_s: float) -> list[tuple[float, Message]]:
        text = dialect.MAVLink_statustext_message(2, b"Arm: Need Position Estimate", 0, 0)
        chatter = dialect.MAVLink_statustext_message(6, b"all is well", 0, 0)
        return [(0.01, ack(400, result)), (0.2, text), (0.21, text), (0.22, chatter)]

    dialogue, _, ended_s = run(ardupilot(), commands.arm(), answer)
    assert dialogue.state is State.REFUSED
    assert dialogue.reason.startswith("vehicle 4 did not arm: ")
    assert dialogue.reason.endswith("(Arm: Need Position Estimate)")
    assert ended_s < 0.5


def test_a_temporary_refusal_is_asked_again_and_in_the_end_told_with_its_reason() -> None:
    refusals = [0]

    def answer(message: Message, now_s: float) -> list[tuple[float, Message]]:
        text = dialect.MAVLink_statustext_message(2, b"Arming denied: not now", 0, 0)
        refusals[0] += 1
        return [(0.01, ack(400, 1)), (0.02, text)]

    dialogue, _, ended_s = run(px4(), commands.arm(), answer)
    assert dialogue.state is State.REFUSED
    assert dialogue.reason == "vehicle 3 did not arm: temporarily rejected (Arming denied: not now)"
    assert TEMPORARY_S < ended_s < TEMPORARY_S + 1.2

    def obeys_later(message: Message, now_s: float) -> list[tuple[float, Message]]:
        if now_s < 2.0:
            return answer(message, now_s)
        return [(0.01, ack(400, 0)), (0.5, beat(PX4, PX4.streaming_mode, armed=True))]

    assert run(px4(), commands.arm(), obeys_later)[0].state is State.DONE


def test_a_refusal_that_may_be_another_requests_is_asked_about_once_more() -> None:
    """One acknowledgement of an earlier request that comes late ends nothing."""
    vehicle = ardupilot()
    run(vehicle, commands.disarm(), silent)
    vehicle.asked_at_s.update({400: -1.0})

    def answer(message: Message, now_s: float) -> list[tuple[float, Message]]:
        late = [(0.2, ack(400, 4))] if now_s == 0.0 else []
        return [*late, (1.5, beat(ARDUPILOT, 4, armed=True))]

    assert run(vehicle, commands.arm(), answer)[0].state is State.DONE
    vehicle = ardupilot()
    vehicle.asked_at_s.update({400: -1.0})
    dialogue, sent, ended_s = run(vehicle, commands.arm(), lambda message, now_s: [(0.15, ack(400, 4))])
    assert (dialogue.state, len(sent)) == (State.REFUSED, 2)
    assert ended_s < 1.0


def test_work_in_progress_is_no_refusal() -> None:
    def answer(message: Message, now_s: float) -> list[tuple[float, Message]]:
        return [(0.01, ack(400, 5)), (3.0, beat(PX4, PX4.streaming_mode, armed=True))]

    assert run(px4(), commands.arm(), answer)[0].state is State.DONE


def test_px4_accepts_blindly_before_it_tells_the_truth() -> None:
    def refuses(message: Message, now_s: float) -> list[tuple[float, Message]]:
        return [(0.004, ack(176, 0)), (0.03, ack(176, 1))]

    def obeys(message: Message, now_s: float) -> list[tuple[float, Message]]:
        seen = dialect.MAVLink_current_mode_message(0, PX4.streaming_mode, PX4.streaming_mode)
        return [(0.004, ack(176, 0)), (0.03, ack(176, 0)), (0.05, seen)]

    vehicle = px4()
    dialogue, _, _ = run(vehicle, commands.set_mode(PX4.streaming_mode), refuses)
    assert (dialogue.state, vehicle.mode) == (State.REFUSED, None)
    assert "temporarily rejected" in dialogue.reason
    vehicle = px4()
    dialogue, sent, _ = run(vehicle, commands.set_mode(PX4.streaming_mode), obeys)
    assert (dialogue.state, vehicle.mode_name) == (State.DONE, "OFFBOARD")
    assert [(m.command, m.param1, m.param2, m.param3) for m in sent] == [(176, 1.0, 6.0, 0.0)]
    assert vehicle.commanded_mode == PX4.streaming_mode


def test_a_refusal_that_telemetry_contradicts_is_no_refusal() -> None:
    def answer(message: Message, now_s: float) -> list[tuple[float, Message]]:
        return [(0.01, ack(176, 1)), (0.2, beat(PX4, PX4.modes["LOITER"]))]

    assert run(px4(), commands.set_mode(PX4.modes["LOITER"]), answer)[0].state is State.DONE


def test_modes_are_spelt_as_each_autopilot_wants() -> None:
    _, sent, _ = run(ardupilot(), commands.set_mode(ARDUPILOT.streaming_mode), silent)
    assert [(m.param1, m.param2, m.param3) for m in sent[:1]] == [(1.0, 4.0, 0.0)]
    _, sent, _ = run(px4(), commands.set_mode(PX4.modes["LOITER"]), silent)
    assert [(m.param1, m.param2, m.param3) for m in sent[:1]] == [(1.0, 4.0, 3.0)]


def test_an_old_acknowledgement_says_nothing_about_a_new_request() -> None:
    vehicle = ardupilot()
    run(vehicle, commands.arm(), lambda message, now_s: [(0.01, ack(400, 4))])
    dialogue = Dialogue(vehicle, commands.arm())
    assert dialogue.step(10.0)
    dialogue.step(10.5)
    dialogue.step(11.5)
    assert dialogue.state is State.PENDING


def test_silence_is_asked_again_until_the_deadline() -> None:
    dialogue, sent, ended_s = run(px4(), commands.arm(), silent)
    assert dialogue.state is State.TIMED_OUT
    assert dialogue.reason == "vehicle 3 did not arm within 12 s"
    assert len(sent) == 24
    assert ended_s == pytest.approx(DEADLINE_S, abs=2 * STEP_S)


def test_the_first_step_always_sends_since_telemetry_may_be_old() -> None:
    vehicle = px4()
    vehicle.mode = PX4.land_mode
    dialogue, sent, _ = run(vehicle, commands.land(), silent)
    assert (dialogue.state, len(sent)) == (State.DONE, 1)


def test_landing_goes_by_command_or_by_mode() -> None:
    vehicle = px4()
    vehicle.armed = True
    _, sent, _ = run(vehicle, commands.land(), lambda message, now_s: [(0.1, beat(PX4, PX4.land_mode, armed=True))])
    assert [m.command for m in sent] == [dialect.MAV_CMD_NAV_LAND]
    assert vehicle.commanded_mode == PX4.land_mode
    vehicle = ardupilot()
    vehicle.armed = True
    _, sent, _ = run(vehicle, commands.land(), lambda message, now_s: [(0.1, beat(ARDUPILOT, 9, armed=True))])
    assert [(m.command, m.param2) for m in sent] == [(dialect.MAV_CMD_DO_SET_MODE, 9.0)]


def position(z_m: float) -> Message:
    message: Message = dialect.MAVLink_local_position_ned_message(0, 0, 0, z_m, 0, 0, 0)
    return message


def standing() -> Vehicle:
    """Return a vehicle that stands armed on its ground; the frame that said so was the last before number 0."""
    vehicle, theirs = ardupilot(), Sender(4, 1)
    for _ in range(255):
        theirs.next_sequence()
    for heard in Codec().receive(theirs.pack(position(0.0))):
        vehicle.handle(heard, 0.0)
    vehicle.armed = True
    return vehicle


def test_take_off_is_done_in_the_air_and_not_asked_again_once_accepted() -> None:
    def answer(message: Message, now_s: float) -> list[tuple[float, Message]]:
        climb = [(1.5 + 0.5 * k, position(-1.0 * k)) for k in range(11)]
        return [(0.006, ack(22, 0)), *climb]

    vehicle = standing()
    dialogue, sent, ended_s = run(vehicle, commands.take_off(10.0), answer)
    assert dialogue.state is State.DONE
    assert [(m.command, m.param7) for m in sent] == [(22, 10.0)]
    assert ended_s == pytest.approx(6.0, abs=2 * STEP_S)  # 9 of 10 m


@pytest.mark.parametrize("acknowledged", [True, False])
def test_take_off_is_asked_again_until_lift_off_and_its_refusals_in_the_air_are_none(acknowledged: bool) -> None:
    """The first is lost, the second lifts it off, and those after it are refused because it is in the air."""
    lifted_s: list[float] = []

    def answer(message: Message, now_s: float) -> list[tuple[float, Message]]:
        if now_s == 0.0:
            return []
        if lifted_s and now_s >= lifted_s[0] + 1.0:
            return [(0.15, ack(22, 4))]
        if not lifted_s:
            lifted_s.append(now_s)
        climb = [(1.2 + 0.1 * k, position(-0.1 * k)) for k in range(101)] if now_s == lifted_s[0] else []
        return [*([(0.15, ack(22, 0))] if acknowledged else []), *climb]

    vehicle = standing()
    dialogue, sent, _ = run(vehicle, commands.take_off(10.0), answer)
    assert dialogue.state is State.DONE
    assert len(sent) == (2 if acknowledged else 5)


def test_a_take_off_that_is_refused_on_the_ground_is_refused() -> None:
    vehicle = ardupilot()
    vehicle.armed = True
    dialogue, _, ended_s = run(vehicle, commands.take_off(10.0), lambda message, now_s: [(0.15, ack(22, 4))])
    assert dialogue.reason == "vehicle 4 did not take off: failed"
    assert ended_s < 5.0


def test_take_off_ends_when_the_vehicle_disarms() -> None:
    def answer(message: Message, now_s: float) -> list[tuple[float, Message]]:
        return [(0.006, ack(22, 0)), (4.5, beat(ARDUPILOT, 4, armed=False)), (4.7, beat(ARDUPILOT, 4, armed=False))]

    vehicle = ardupilot()
    vehicle.armed = True
    dialogue, _, _ = run(vehicle, commands.take_off(10.0), answer)
    assert (dialogue.state, "disarmed" in dialogue.reason) == (State.REFUSED, True)


def test_take_off_by_command_is_not_for_px4_nor_to_nowhere() -> None:
    with pytest.raises(VehicleError, match="PX4 takes off by setpoints"):
        Dialogue(px4(), commands.take_off(5.0)).step(0.0)
    for height_m in (math.nan, 0.0, -1.0, math.inf):
        with pytest.raises(VehicleError, match="take-off height"):
            commands.take_off(height_m)


@pytest.mark.parametrize(("rate_hz", "interval_us"), [(50.0, 20000.0), (10.0, 100000.0), (-1.0, -1.0), (0.5, 2e6)])
def test_stream_rates_are_intervals_on_the_wire(rate_hz: float, interval_us: float) -> None:
    request = commands.set_message_interval(32, rate_hz)
    dialogue, sent, _ = run(px4(), request, lambda message, now_s: [(0.01, interval(32, round(interval_us)))])
    assert (dialogue.state, sent[0].param1, sent[0].param2) == (State.DONE, 32.0, interval_us)


def interval(message_id: int, interval_us: int) -> Message:
    message: Message = dialect.MAVLink_message_interval_message(message_id, interval_us)
    return message


def test_the_answer_about_another_stream_is_none() -> None:
    def answer(message: Message, now_s: float) -> list[tuple[float, Message]]:
        late = [(0.01, interval(30, 20000)), (0.02, ack(511, 0)), (0.03, ack(511, 2))] if now_s == 0.0 else []
        return [*late, (1.0, interval(32, 20000))]

    dialogue, _, ended_s = run(px4(), commands.set_message_interval(32, 50.0, optional=False), answer)
    assert dialogue.state is State.DONE
    assert ended_s > 1.0


def test_a_stream_that_was_not_set_because_the_request_was_lost_is_asked_for_again() -> None:
    def answer(message: Message, now_s: float) -> list[tuple[float, Message]]:
        return [(0.01, interval(32, 20000 if now_s > 2.0 else 1000000))] if message.command == 510 else []

    assert run(px4(), commands.set_message_interval(32, 50.0, optional=False), answer)[0].state is State.DONE


def test_a_refused_stream_matters_only_if_it_is_needed() -> None:
    def refuses(message: Message, now_s: float) -> list[tuple[float, Message]]:
        return [(0.01, interval(round(message.param1), -1))] if message.command == 510 else [(0.01, ack(511, 2))]

    dialogue, _, _ = run(px4(), commands.set_message_interval(436, 5.0), refuses)
    assert dialogue.state is State.DONE
    assert dialogue.reason == "vehicle 3 did not change the interval of message 436: it does not send it"
    dialogue, _, _ = run(px4(), commands.set_message_interval(32, 50.0, optional=False), refuses)
    assert dialogue.state is State.REFUSED


def test_a_requested_message_is_done_when_it_came() -> None:
    def answer(message: Message, now_s: float) -> list[tuple[float, Message]]:
        origin = dialect.MAVLink_gps_global_origin_message(473977428, 85455967, 489052)
        return [(0.005, ack(512, 0)), (0.3, origin)]

    vehicle = px4()
    dialogue, sent, ended_s = run(vehicle, commands.request_origin(), answer)
    assert (dialogue.state, sent[0].param1) == (State.DONE, 49.0)
    assert ended_s > 0.3
    assert vehicle.origin is not None


def test_a_vehicle_need_not_tell_which_hardware_it_is() -> None:
    vehicle = px4()
    dialogue, sent, ended_s = run(vehicle, commands.request_version(), silent)
    assert (dialogue.state, sent[0].param1) == (State.DONE, 148.0)
    assert len(sent) >= 10
    assert ended_s < 6.0
    assert vehicle.uid == ""


class Store:
    """Parameters of one autopilot, as it keeps and tells them."""

    def __init__(self, profile: AutopilotProfile, name: str, value: float, param_type: int) -> None:
        self.profile, self.name, self.value, self.param_type = profile, name, value, param_type

    def __call__(self, message: Message, now_s: float) -> list[tuple[float, Message]]:
        if message.param_id != self.name:
            error = dialect.MAVLink_param_error_message(255, 190, message.param_id.encode(), -1, 1)
            return [(0.01, error)] if self.profile is PX4 else []
        if message.get_type() == "PARAM_SET":
            assert message.param_type == self.param_type
            self.value = message.param_value
            return [(0.01, self.told(self.value))]
        return [(0.07, self.told(encode(self.name, self.value, self.param_type, self.profile.encoding)))]

    def told(self, carried: float) -> Message:
        message: Message = dialect.MAVLink_param_value_message(self.name.encode(), carried, self.param_type, 1, 65535)
        return message


def test_an_unknown_type_is_read_before_it_is_written() -> None:
    int32 = dialect.MAV_PARAM_TYPE_INT32
    store, vehicle = Store(PX4, "COM_OBL_RC_ACT", 0.0, int32), px4()
    dialogue, sent, _ = run(vehicle, commands.write_parameter("COM_OBL_RC_ACT", 4.0), store)
    assert dialogue.state is State.DONE
    assert [m.get_type() for m in sent] == ["PARAM_REQUEST_READ", "PARAM_SET"]
    assert vehicle.params == {"COM_OBL_RC_ACT": 4.0}
    assert store.value == encode("COM_OBL_RC_ACT", 4.0, int32, Encoding.BYTEWISE)


def test_reading_a_parameter() -> None:
    store, vehicle = Store(ARDUPILOT, "WPNAV_SPEED", 1000.0, 9), ardupilot()
    dialogue, sent, ended_s = run(vehicle, reading("WPNAV_SPEED"), store)
    assert (dialogue.state, vehicle.params["WPNAV_SPEED"], len(sent)) == (State.DONE, 1000.0, 1)
    assert ended_s < 0.2


def test_px4_says_that_it_does_not_know_a_parameter() -> None:
    store = Store(PX4, "X", 1.0, 9)
    dialogue, _, _ = run(px4(), reading("NONE"), store)
    assert dialogue.state is State.REFUSED
    assert dialogue.reason == "vehicle 3 did not tell its parameter NONE: there is no parameter of this name"
    assert run(px4(), reading("NONE", needed=False), store)[0].state is State.DONE
    assert run(px4(), reading("NONE", "X"), store)[0].state is State.DONE


def test_ardupilot_is_silent_about_what_it_does_not_know_but_tells_something_else() -> None:
    vehicle, store = ardupilot(), Store(ARDUPILOT, "X", 1.0, 9)
    run(vehicle, reading("X"), store)
    dialogue, sent, ended_s = run(vehicle, reading("NONE", needed=False), store)
    assert dialogue.state is State.DONE
    assert sum(message.param_id == "X" for message in sent) >= 13
    assert ended_s < 6.0


def test_a_needed_parameter_is_asked_for_to_the_end() -> None:
    vehicle, store = ardupilot(), Store(ARDUPILOT, "X", 1.0, 9)
    run(vehicle, reading("X"), store)
    dialogue, _, ended_s = run(vehicle, reading("NONE"), store)
    assert dialogue.state is State.TIMED_OUT
    assert dialogue.reason == "vehicle 4 did not tell its parameter NONE within 30 s, but tells X"
    assert ended_s == pytest.approx(30.0, abs=2 * STEP_S)


@pytest.mark.parametrize("needed", [True, False])
def test_a_parameter_that_is_not_heard_is_not_unknown(needed: bool) -> None:
    dialogue, _, ended_s = run(ardupilot(), reading("FS_GCS_ENABLE", needed=needed), silent)
    assert dialogue.state is State.TIMED_OUT
    assert dialogue.reason == "vehicle 4 did not tell its parameter FS_GCS_ENABLE within 30 s"
    assert ended_s == pytest.approx(30.0, abs=2 * STEP_S)


def test_a_written_value_that_comes_back_different_is_not_done() -> None:
    def clips(message: Message, now_s: float) -> list[tuple[float, Message]]:
        return [(0.01, dialect.MAVLink_param_value_message(b"RTL_ALT", 127.0, 9, 1, 65535))]

    dialogue, _, _ = run(ardupilot(), commands.write_parameter("RTL_ALT", 300.0), clips)
    assert dialogue.state is State.TIMED_OUT


def test_disarming_is_never_forced() -> None:
    vehicle = px4()
    vehicle.armed = True
    _, sent, _ = run(vehicle, commands.disarm(), silent)
    assert (sent[0].command, sent[0].param1, sent[0].param2) == (400, 0.0, 0.0)  # 21196 would stop motors in the air


def test_a_vehicle_asked_to_arm_a_moment_ago_is_not_disarmed_because_it_was_before() -> None:
    """The request to arm is under way: it arrives before or after the first one to disarm."""
    armed = [False]

    def answer(message: Message, now_s: float) -> list[tuple[float, Message]]:
        armed[0] = now_s < 0.1
        return [(0.2 + 0.2 * k, beat(ARDUPILOT, 4, armed=armed[0])) for k in range(5)]

    vehicle = ardupilot()
    Dialogue(vehicle, commands.arm()).step(0.0)
    assert vehicle.may_be_armed
    dialogue, sent, ended_s = run(vehicle, commands.disarm(), answer)
    assert dialogue.state is State.DONE
    assert len(sent) > 1
    assert ended_s > 0.6
    assert not armed[0]
    assert not vehicle.may_be_armed


def test_our_heartbeat_is_that_of_a_ground_station() -> None:
    (message,) = Codec().receive(Sender().pack(commands.heartbeat()))
    assert (message.type, message.autopilot) == (dialect.MAV_TYPE_GCS, dialect.MAV_AUTOPILOT_INVALID)
    assert (message.get_srcSystem(), message.get_srcComponent()) == (255, 190)


@pytest.mark.parametrize(
    ("request_", "said"),
    [
        (commands.arm(), "vehicle 4 did not arm within 12 s"),
        (commands.disarm(), "vehicle 4 did not disarm within 12 s"),
        (commands.set_mode(4), "vehicle 4 did not change its mode within 12 s"),
        (commands.land(), "vehicle 4 did not begin to land within 12 s"),
        (commands.take_off(4.0), "vehicle 4 did not take off: it disarmed before lift-off"),
        (commands.request_origin(), "vehicle 4 did not send message 49 within 12 s"),
        (
            commands.set_message_interval(32, 50.0, optional=False),
            "vehicle 4 did not change the interval of message 32 within 12 s",
        ),
        (
            commands.write_parameter("FS_GCS_ENABLE", 5.0),
            "vehicle 4 did not set its parameter FS_GCS_ENABLE to 5 within 12 s",
        ),
    ],
    ids=lambda value: value.name if isinstance(value, Request) else "",
)
def test_what_a_vehicle_did_not_do_is_a_sentence(request_: Request, said: str) -> None:
    vehicle = ardupilot()
    vehicle.armed = request_.name not in ("arm", "take off")
    assert run(vehicle, request_, silent)[0].reason == said


def test_a_vehicle_of_a_named_network_is_told_with_it() -> None:
    vehicle = Vehicle(VehicleAddress("west", 4), PX4, 0.0)
    assert run(vehicle, commands.arm(), silent)[0].reason == "vehicle west/4 did not arm within 12 s"


def test_the_take_off_command_says_nothing_but_the_height() -> None:
    vehicle = ardupilot()
    vehicle.armed = True
    _, sent, _ = run(vehicle, commands.take_off(4.0), silent)
    for command in sent:
        assert [getattr(command, f"param{number}") for number in range(1, 8)] == [0.0] * 6 + [4.0]


def test_an_answer_of_the_very_instant_of_the_question_is_to_an_earlier_one() -> None:
    """An answer takes a while at least: what is there already when the question leaves cannot be it."""
    vehicle, now_s = ardupilot(), 10.0
    dialogues = [
        request.dialogue(vehicle)
        for request in (
            commands.arm(),
            commands.request_origin(),
            reading("FS_GCS_ENABLE"),
            commands.set_message_interval(32, 50.0),
        )
    ]
    for dialogue in dialogues:
        assert dialogue.step(now_s)
    said = (
        ack(400, 4),
        interval(32, 20000),
        dialect.MAVLink_gps_global_origin_message(0, 0, 0),
        dialect.MAVLink_param_value_message(b"FS_GCS_ENABLE", 5.0, 9, 1, 0),
        dialect.MAVLink_param_error_message(255, 190, b"FS_GCS_ENABLE", -1, 1),
    )
    sender, codec = Sender(vehicle.system_id, 1), Codec()
    for message in said:
        for heard in codec.receive(sender.pack(message)):
            vehicle.handle(heard, now_s)
    for wait_s in (0.02, 0.28):
        for dialogue in dialogues:
            assert not dialogue.step(now_s + wait_s)
    assert [dialogue.state for dialogue in dialogues] == [State.PENDING] * 4
