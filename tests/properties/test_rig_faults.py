"""Whatever lies, delays or doubles answers on the rig: they stay well formed and in order, and the motors well."""

import contextlib
import math

from hypothesis import strategies as st

from lerobot_robot_yam.damiao.codec import SpecialCommand, decode_feedback, encode_mit
from lerobot_robot_yam.damiao.tables import FRAME_TIME_S, Fault, motor_type
from lerobot_robot_yam.rig.bus.adapter import Adapter, HoldBack
from lerobot_robot_yam.rig.devices.packets import Frame
from tests.properties.test_rig_frames import client_frames
from tests.support.cases import finite, for_all
from tests.support.rig_desk import Desk

CHANNEL = "leader_left"
KIND = "DM4310"
WRIST = 6

LIE = st.fixed_dictionaries(
    {},
    optional={
        "position_rad": finite() | st.floats(-30.0, 30.0),
        "velocity_rad_s": finite() | st.floats(-50.0, 50.0),
        "torque_nm": finite() | st.floats(-50.0, 50.0),
        "answers": st.integers(0, 5),
        "freeze": st.booleans(),
    },
) | st.just(False)


def fault(desk, motor, kind, value=True, **details):
    desk.fault(CHANNEL, motor, kind, value, **details)


def swing(lies, garbled, doubled):
    """What a wrist does, and answers, that is swung to and fro while `lies` are told of it one after the other."""
    with contextlib.closing(Desk(CHANNEL)) as desk:
        desk.special(WRIST, SpecialCommand.ENABLE)
        if doubled:
            fault(desk, WRIST, "duplicate")
        fault(desk, WRIST, "corrupt_rate", garbled, all_bytes=True)
        did, told = [], []
        for tick, lie in enumerate(lies):
            if lie is not None:
                fault(desk, WRIST, "reading", lie)
            answers = desk.send((WRIST, encode_mit(KIND, 0.3 * (-1) ** (tick // 4), 0.0, 20.0, 1.0, 0.0)))
            told.append([answer.data for answer in answers])
            desk.run(0.004)
            did.append((desk.motor(WRIST).motor_angle_rad, desk.motor(WRIST).torque_nm))
        return did, told


@for_all(
    short=20,
    lies=st.lists(st.none() | LIE, min_size=1, max_size=15),
    garbled=st.floats(0.0, 1.0),
    doubled=st.booleans(),
)
def test_answers_that_lie_are_well_formed_and_change_nothing_in_the_motor(lies, garbled, doubled):
    did, told = swing(lies, garbled, doubled)
    true, _ = swing([None] * len(lies), 0.0, False)
    assert did == true
    row = motor_type(KIND)
    for answers in told:
        assert len(answers) == 1 + doubled
        for data in answers:
            state = decode_feedback(KIND, data)
            assert len(data) == 8 and abs(state.position) <= row.position_max_rad
            assert abs(state.velocity) <= row.velocity_max_rad_s and abs(state.torque) <= row.torque_max_nm


@for_all(short=20, packets=st.lists(st.lists(client_frames(), max_size=6), min_size=1, max_size=6))
def test_no_frame_breaks_a_second_arm(packets):
    with contextlib.closing(Desk(CHANNEL)) as desk:
        fault(desk, None, "second_arm")
        for can_id in range(1, 7):
            desk.send((can_id, SpecialCommand.ENABLE.value))
        for frames in packets:
            desk.channel.receive(desk._theirs, frames, desk.now_s)
            desk.run(0.004)
            assert all(len(answer.data) <= 8 and math.isfinite(answer.stamp_s) for answer in desk.heard())
        desk.run(0.5)
        for motor in desk.channel.motors:
            twin = motor.twin
            assert math.isfinite(twin.drive.angle()) and math.isfinite(twin.drive.velocity())
            assert abs(twin.torque_nm) <= motor_type(twin.kind).torque_max_nm * (1 + 1e-9)
            assert twin.fault in set(Fault)


HOLD = st.none() | st.builds(
    HoldBack,
    begin_s=st.floats(0.0, 1.0),
    seconds=st.floats(0.0, 0.1),
    every_s=st.floats(0.1, 0.5) | st.just(math.inf),
)
STEP = st.tuples(st.floats(0.0, 0.02), st.none() | st.floats(0.0, 0.05), st.booleans(), HOLD)


@for_all(steps=st.lists(STEP, min_size=1, max_size=40))
def test_an_adapter_keeps_the_order_both_ways_and_loses_nothing(steps):
    adapter, client = Adapter(0.0), object()
    now, through, sent, given, arrivals = 0.0, 0.0, [], [], []

    def pass_on(until_s):
        while adapter.due_s <= until_s:
            due_s = adapter.due_s
            for who, timed in adapter.take(due_s):
                assert who is client and all(at_s <= due_s for at_s, _ in timed)
                given.extend(frame.id for _, frame in timed)

    for number, (pause_s, latency_s, changes_hold, hold) in enumerate(steps):
        now += pause_s
        pass_on(now)
        adapter.latency_s = adapter.latency_s if latency_s is None else latency_s
        adapter.hold = hold if changes_hold else adapter.hold
        adapter.put(client, [(now + adapter.latency_s, Frame(now, number, b""))])
        sent.append(number)
        through = max(through, now) + FRAME_TIME_S
        arrival_s = adapter.arrival_s(through)
        assert arrival_s >= through + adapter.latency_s - 1e-9
        arrivals.append(arrival_s)
    pass_on(1e9)
    assert given == sent
    assert len(arrivals) == len(steps)
    assert arrivals == sorted(arrivals)
