"""The control client against a live rig."""

import time

import can
import numpy as np
import pytest

from lerobot_robot_yam.damiao import handle_encoder
from lerobot_robot_yam.damiao.codec import SpecialCommand
from lerobot_robot_yam.damiao.tables import Fault
from lerobot_robot_yam.errors import ConfigError, RigError
from lerobot_robot_yam.rig.control import RigControl
from tests.support.waiting import wait


def enable(rig, channel, motors):
    with can.Bus(interface="yam_sim", channel=channel, rig=rig.name) as bus:
        for can_id in motors:
            data = SpecialCommand.ENABLE.value
            bus.send(can.Message(arbitration_id=can_id, data=data, is_extended_id=False))
            assert bus.recv(5.0).arbitration_id == can_id + 16


def test_simulated_time_follows_real_time(rig):
    first = rig.state()
    time.sleep(0.5)
    second = rig.state()
    elapsed = second["monotonic_s"] - first["monotonic_s"]
    assert elapsed > 0.45
    assert second["sim_s"] - first["sim_s"] <= elapsed + 1e-6  # never ahead; behind only after a slip
    if rig.stats()["slips"] == 0:
        assert second["sim_s"] - first["sim_s"] == pytest.approx(elapsed, abs=2e-3)


def test_state_shows_every_arm_and_prop(rig):
    state = rig.state(bodies=True)
    assert list(state["arms"]) == ["follower_left", "follower_right", "leader_left", "leader_right"]
    follower, leader = state["arms"]["follower_left"], state["arms"]["leader_left"]
    assert len(follower["q"]) == 6 and 0 <= follower["opening"] <= 1 and follower["trigger"] is None
    assert leader["opening"] is None and leader["trigger"] == 0.0
    assert list(follower["motors"]) == [*(f"joint_{i}" for i in range(1, 7)), "gripper"]
    assert len(state["props"]["cube"]["pos"]) == 3
    assert state["bodies"]["follower_left/link6"] == pytest.approx(follower["tcp_site"]["pos"], abs=0.3)


def test_a_prop_stays_where_it_is_placed(rig):
    rig.place("cube", (0.5, 0.0, 0.3))
    assert rig.state()["props"]["cube"]["pos"][:2] == pytest.approx([0.5, 0.0], abs=1e-3)
    wait(lambda: rig.state()["props"]["cube"]["pos"][2] < 0.05)  # it falls onto the table
    assert rig.state()["props"]["cube"]["pos"][2] > 0.0


def test_an_arm_can_be_posed_and_pushed(rig):
    rig.set_pose("follower_right", [0.5, 0, 0, 0, 0, 0], opening=0.5)
    arm = rig.state()["arms"]["follower_right"]
    assert arm["q"][0] == pytest.approx(0.5, abs=0.02)
    assert arm["opening"] == pytest.approx(0.5, abs=0.02)
    rig.push("follower_right", "link3", (0, 30, 0), 0.3)
    wait(lambda: abs(rig.state()["arms"]["follower_right"]["q"][0] - 0.5) > 0.05)
    assert rig.wait_event("push", 1.0)["body"] == "follower_right/link3"


def test_cutting_torque_disables_every_motor(rig):
    enable(rig, "follower_left", [1, 2])
    motors = rig.state()["arms"]["follower_left"]["motors"]
    assert motors["joint_1"]["enabled"] and not motors["joint_3"]["enabled"]
    rig.cut_torque("follower_left")
    motors = rig.state()["arms"]["follower_left"]["motors"]
    assert not any(motor["enabled"] for motor in motors.values())


def test_motors_log_events(rig):
    since = len(rig.events())
    enable(rig, "follower_left", [4])
    event = rig.wait_event("motor_fault", 5.0, since=since, channel="follower_left")  # nobody feeds its watchdog
    assert (event["motor"], event["fault"]) == ("joint_4", Fault.COMMUNICATION_LOST)
    enabled = rig.wait_event("motor_enabled", 1.0, since=since)
    assert 0.39 < event["sim_s"] - enabled["sim_s"] < 0.47  # a rig that was held up makes several steps at once
    rig.log("note", text="seen")
    assert rig.wait_event("note", 1.0, since=since)["text"] == "seen"


def test_handle_inputs_reach_the_bus(rig):
    rig.trigger("leader_left", 0.75)
    rig.buttons("leader_left", sync=True)
    with can.Bus(interface="yam_sim", channel="leader_left", rig=rig.name) as bus:
        data = handle_encoder.encode_report_request()
        bus.send(can.Message(arbitration_id=handle_encoder.REQUEST_ID, data=data, is_extended_id=False))
        report = handle_encoder.decode_report(bytes(bus.recv(5.0).data))
    assert report.trigger == pytest.approx(0.75, abs=2e-3)
    assert report.buttons == (True, False)
    rig.buttons("leader_left")


def test_a_hand_pulls_a_leader_and_lets_go_with_its_client(rig):
    target = [0.3, 0.5, 0.5, 0.0, 0.0, 0.0]
    with RigControl(rig.name) as person:
        start = person.state()["arms"]["leader_right"]["q"]
        person.hand("leader_right", [0.0, 1.0], [start, target], [0.0, 1.0])
        wait(lambda: np.abs(np.subtract(rig.state()["arms"]["leader_right"]["q"], target)).max() < 0.05)
        wait(lambda: rig.state()["arms"]["leader_right"]["trigger"] == 1.0)
        assert rig.state()["arms"]["leader_right"]["held"]
    wait(lambda: not rig.state()["arms"]["leader_right"]["held"])
    assert rig.state()["arms"]["leader_right"]["trigger"] == 0.0


def test_somebody_elses_end_opens_no_hand(rig):
    start = rig.state()["arms"]["leader_right"]["q"]
    with RigControl(rig.name) as visitor:
        visitor.release("leader_right")
        with pytest.raises(ConfigError, match="joints"):
            visitor.hand("leader_right", [0], [[0] * 5])
        rig.hand("leader_right", [0.0], [start])
        clients = rig.stats()["clients"]
    wait(lambda: rig.stats()["clients"] < clients)
    assert rig.state()["arms"]["leader_right"]["held"]
    rig.release("leader_right")


def test_a_trace_has_every_frame_a_client_sent(rig):
    rig.trace_start("follower_right")
    with can.Bus(interface="yam_sim", channel="follower_right", rig=rig.name) as bus:
        for can_id in (3, 4):
            data = (can_id, 0, 0xCC, 0, 0, 0, 0, 0)
            bus.send(can.Message(arbitration_id=0x7FF, data=data, is_extended_id=False))
            bus.recv(5.0)
    trace = rig.trace("follower_right")
    assert [(ident, first) for _, _, ident, first in trace] == [(0x7FF, 3), (0x7FF, 4)]
    assert all(sent <= arrived for sent, arrived, _, _ in trace)


@pytest.mark.parametrize(
    ("call", "text"),
    [
        (lambda rig: rig.request("fly"), "unknown operation 'fly'; known: .*state"),
        (lambda rig: rig.cut_torque("can0"), "no channel 'can0'"),
        (lambda rig: rig.place("ball", (0, 0, 0)), "no prop 'ball'"),
        (lambda rig: rig.place("cube", (0, 0, float("nan"))), "finite"),
        (lambda rig: rig.place("cube", (0, 0, 0.1), (0, 0, 0, 0)), "not an orientation"),
        (lambda rig: rig.set_pose("leader_left", [0, 0]), "6 joints"),
        (lambda rig: rig.set_pose("follower_left", opening=float("nan")), "finite"),
        (lambda rig: rig.push("leader_left", "link2", (0, 0, 1), float("nan")), "finite"),
        (lambda rig: rig.trigger("leader_left", float("nan")), "finite"),
        (lambda rig: rig.push("leader_left", "tail", (0, 0, 1), 1), "no body 'leader_left/tail'"),
        (lambda rig: rig.trigger("follower_left", 1), "no teaching handle"),
        (lambda rig: rig.hand("leader_middle", [0], [[0] * 6]), "no channel 'leader_middle'"),
        (lambda rig: rig.hand("leader_left", [0, 0], [[0] * 6] * 2), "increasing"),
        (lambda rig: rig.hand("leader_left", [0], [[0] * 5]), "joints"),
        (lambda rig: rig.request("push", body="cube"), "push.*channel"),
        (lambda rig: rig.lift("leader_left", [0.0] * 5), "6 joints cannot be brought to"),
        (lambda rig: rig.lift("leader_left", [float("nan")] * 6), "cannot be brought to"),
        (lambda rig: rig.lift("leader_left", [0.0] * 6, 0.0), "a time above zero"),
        (lambda rig: rig.bring_home("leader_middle"), "no channel"),
        (lambda rig: rig.forces("leader_middle"), "no channel"),
    ],
)
def test_impossible_requests_are_refused_by_name(rig, call, text):
    with pytest.raises(ConfigError, match=text):
        call(rig)
    assert rig.state()["sim_s"] > 0  # and the rig lives on


def test_a_remark_does_not_renumber_the_events(rig):
    before = rig.events()[-1]["number"] if rig.events() else -1
    rig.log("remark", number="3a")
    assert rig.events()[-1]["number"] > before


def test_a_number_beyond_any_float_does_not_end_the_rig(rig):
    with pytest.raises(RigError, match="too large"):
        rig.place("cube", (0, 0, 10**400))
    assert rig.state()["sim_s"] > 0


def test_no_event_in_time_is_an_error(rig):
    with pytest.raises(RigError, match="no event miracle"):
        rig.wait_event("miracle", 0.05)
