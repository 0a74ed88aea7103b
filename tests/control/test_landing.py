"""Landed means: cutting torque then moves no body by more than 1 cm. From random end poses, by the rig's truth."""

import itertools

import numpy as np
import pytest

from lerobot_robot_yam.arm.config import ArmConfig
from lerobot_robot_yam.arm.kinematics import YamKinematics
from lerobot_robot_yam.arm.profile_files import load_arm, load_gripper
from lerobot_robot_yam.arm.resolved_arm import ResolvedArm
from lerobot_robot_yam.control.landing.landing import Landing
from lerobot_robot_yam.control.landing.landing_move import LANDING_SPEED_RAD_S, Phase, Seen
from lerobot_robot_yam.control.laws.set_point import SetPoint
from lerobot_robot_yam.damiao.tables import Fault
from lerobot_robot_yam.state.modes import Mode
from tests.support.landed import MOST_M
from tests.support.rigged import arm_on, either_rig, pause, rig_of, track
from tests.support.tiers import spread

CHANNEL = "follower_left"
UNHEARD_AFTER = 20  # ticks


rig = either_rig(CHANNEL)


def random_poses(n, seed, arm="yam", gripper="linear_4310"):
    """Poses whose straight joint line from rest keeps every body of the arm above the table."""
    rng = np.random.default_rng(seed)
    profile = load_arm(arm)
    sites = [YamKinematics(arm, gripper, site) for site in ("tcp_site", "grasp_site")]
    low, high = profile.joint_limits_rad.T
    rest = profile.rest_q(load_gripper(gripper))
    poses = []
    while len(poses) < n:
        q = rng.uniform(low, high)
        line = [rest + share * (q - rest) for share in np.linspace(0.1, 1, 10)]
        clear = min(min(site.fk(p)[2, 3] for site in sites) for p in line[1:])
        if clear > 0.08 and abs(q[0]) < 1.2:
            poses.append(q)
    return poses


def land_and_watch(rig, arm, channel, but="", fades=False):
    """Land; returns how far any body moved after torque was cut, m, and the landing's greatest joint speed, rad/s.

    but: a limp joint, whose speed is nobody's.
    fades: the arm lies before torque is cut, and by then its joints get next to none.
    """
    last_held, held_speeds, torques = None, [], []
    judged = [f"joint_{number + 1}" != but for number in range(arm._session[channel].hardware.joints)]
    arm._session[channel].land()
    while True:
        state = rig.state(bodies=True)
        motors = state["arms"][channel]["motors"].values()
        bodies = {name: pos for name, pos in state["bodies"].items() if name.startswith(f"{channel}/")}
        if not any(motor["enabled"] for motor in motors):
            break
        torques = [abs(motor["torque_nm"]) for motor in motors][: len(judged)]
        last_held = bodies
        held_speeds.append(np.abs(state["arms"][channel]["dq"])[judged].max())
        arm.clock.sleep(0.01)
    assert not fades or np.max(np.array(torques)[judged]) < 0.2
    arm.clock.sleep(1.5)
    after = rig.state(bodies=True)["bodies"]
    moved = max(float(np.linalg.norm(np.subtract(after[name], pos))) for name, pos in last_held.items())
    return moved, max(held_speeds)


def check_landing(rig, q, channel=CHANNEL, **fields):
    with arm_on(rig, channel, **fields) as arm:
        arm.move_to(q, gripper=0.5, speed_rad_s=1.4)
        arm.clock.sleep(0.6)  # the speed that is judged is the landing's
        moved, speed = land_and_watch(rig, arm, channel, fades=True)
        assert arm._session[channel].mode() is Mode.OFF
    assert moved <= MOST_M
    assert speed <= 2 * LANDING_SPEED_RAD_S


@pytest.mark.parametrize("poses, seed", spread([(1, 7), (20, 11)], 0))
def test_landed_from_random_poses(rig, poses, seed):
    for q in random_poses(poses, seed):
        check_landing(rig, q)


def test_zero_is_not_a_landed_pose(rig):
    """The reason for all this: an arm left at zero drops its wrist when torque is cut."""
    rig.set_pose(CHANNEL, [0.0] * 6)
    before = rig.state()["arms"][CHANNEL]["grasp_site"]["pos"]
    pause(rig, 1.5)
    after = rig.state()["arms"][CHANNEL]["grasp_site"]["pos"]
    assert np.linalg.norm(np.subtract(after, before)) > 2 * MOST_M


def test_a_load_that_nobody_told_of_is_landed_with_a_sagging_wrist(rig, caplog, capfd):
    with arm_on(rig, CHANNEL) as arm:
        arm.move_to([0.0, 1.0, 1.0, 0, 0, 0], speed_rad_s=1.4)
        rig.push(CHANNEL, "gripper", [0, 0, -1.0 * 9.81], 30.0)
        arm.land()
        assert arm._session[CHANNEL].mode() is Mode.OFF
    assert "cannot land" not in caplog.text + capfd.readouterr().err


def test_an_arm_that_lies_already_stays_where_it_is(rig):
    with arm_on(rig, CHANNEL) as arm:
        before = np.array(rig.state()["arms"][CHANNEL]["q"])
        arm.clock.sleep(0.3)
        arm._session[CHANNEL].land()
        farthest = 0.0
        while arm._session[CHANNEL].mode() is not Mode.OFF:
            farthest = max(farthest, np.abs(np.array(rig.state()["arms"][CHANNEL]["q"]) - before).max())
            arm.clock.sleep(0.01)
    assert farthest < 0.03


def plan_of_landing(q, struck=None, unheard=None):
    """The phases within ten seconds of an arm that follows at once. `struck`: (phase, joint, rad) that throw it back.

    unheard: (phase, joint) that is not heard any more once it has moved for a while.
    """
    hardware = ResolvedArm(ArmConfig(channel="x", name="left"))
    joints = hardware.joints
    q = np.array([hardware.lower[0] + q[0], *q[1:]])
    most, end = np.full(hardware.n, 30.0), np.full(hardware.n, 5.0)  # rad/s²
    setpoint = SetPoint(hardware.speed_limit, most, hardware.lower, hardware.upper, end)
    setpoint.seed(np.append(q, 0.5))
    landing, phases, usable = Landing(hardware, q, setpoint, 0.0), [], np.ones(joints, bool)
    for tick in range(1, 2500):
        now = tick * 0.004
        if unheard is not None and phases[-UNHEARD_AFTER:] == [unheard[0]] * UNHEARD_AFTER:
            usable[unheard[1]] = False
        before = landing._sink.shares
        landing.advance(Seen(now, q, np.zeros(joints), usable))
        assert (before - landing._sink.shares).max() < 0.03, "stiffness fades within 0.15 s at the earliest"
        phases.append(landing.phase)
        if struck is not None and landing.phase is struck[0]:
            setpoint.fall_back(*struck[1:])
            struck = None
        setpoint.step(now, 0.004)
        q = setpoint.q[:joints]
        if landing.phase is Phase.LANDED:
            break
    assert struck is None
    return [phase for phase, _ in itertools.groupby(phases)]


@pytest.mark.parametrize("beyond_rad", [0.0, 0.07, 0.14])
def test_an_arm_lands_whose_base_stands_beyond_its_range(beyond_rad):
    assert plan_of_landing([-beyond_rad, 1.0, 1.0, 0.0, 0.0, 0.0])[-1] is Phase.LANDED


@pytest.mark.parametrize("phase", [Phase.FOLD, Phase.LOWER])
def test_a_joint_that_is_struck_while_it_lands_goes_on_as_fast_as_others(phase):
    assert plan_of_landing([1.0, 0.0, 0.0, 1.0, 0.0, 0.0], (phase, 1, 1.2))[-1] is Phase.LANDED


@pytest.mark.parametrize("joint, then", [(3, Phase.SINK), (4, Phase.FADE)])
def test_a_wrist_that_is_not_heard_on_its_way_down_sinks(joint, then):
    phases = plan_of_landing([0.0, 1.0, 1.0, 0.0, 0.0, 0.0], unheard=(Phase.LOWER, joint))
    assert phases[-3:] == [Phase.LOWER, then, Phase.LANDED]


@pytest.mark.long
def test_a_wrist_that_is_not_believed_on_its_way_down_does_not_fall(rig):
    with arm_on(rig, CHANNEL) as arm:
        arm.move_to([0.2, 0.5, 0.5, 0.5, 0.0, 0.0], speed_rad_s=1.0)
        port = arm._session[CHANNEL]
        rest = port.hardware.rest_q
        port.land()
        while np.abs(port.published().q - rest)[1:4].max() > 0.3:  # only the wrist is above its resting place
            arm.clock.sleep(0.004)
        rig.fault(CHANNEL, "joint_4", "reading", {"position_rad": 2 * np.pi})
        moved, _ = land_and_watch(rig, arm, CHANNEL)
    assert moved <= MOST_M


@pytest.mark.long
@pytest.mark.parametrize("forces", [([[30.0, 33.0, 22.0]],), ([[30.0, 33.0, 22.0], [-30.0, -33.0, 22.0]],)])
def test_a_limp_arm_that_is_pushed_does_not_come_free(rig, forces, caplog, capfd):
    """Its set-point is nothing that it could spring to, and stays, or a landing would begin anew with each push."""
    caplog.set_level("INFO")
    with arm_on(rig, CHANNEL) as arm:
        arm.move_to([-0.7, 1.5, 1.4, -0.5, 0.0, 0.0], speed_rad_s=1.4)
        rig.fault(CHANNEL, None, "cable_out", True)  # for longer than the motors' watchdogs wait
        arm.clock.sleep(0.75)
        rig.fault(CHANNEL, None, "cable_out", False)
        arm.clock.sleep(2.0)
        assert not any(motor["enabled"] for motor in rig.state()["arms"][CHANNEL]["motors"].values())
        for force in forces:
            rig.push(CHANNEL, "link2", force, 0.4)
            arm.clock.sleep(1.0)
    assert "came free" not in caplog.text + capfd.readouterr().err


# From 1.1 the wrist may slip off by itself before it is brought down.
@pytest.mark.long
@pytest.mark.parametrize("shoulder, barred", [(0.5, True), (0.8, True), (0.95, True), (1.0, True), (1.1, False)])
def test_an_arm_lands_whose_wrist_is_hooked_behind_its_own_shoulder(rig, shoulder, barred, caplog, capfd):
    """The straight way down is barred by the arm itself: it goes round."""
    with arm_on(rig, CHANNEL) as arm:
        arm.move_to([0.0, 0.9, 0.9, 0, 0, 0], speed_rad_s=1.4)
        for pose in ([0.0, shoulder, 0.1, 0, 0, 0], [0.0, shoulder, 0.1, -1.65, 0, 0]):
            track(arm._session, {CHANNEL: pose}, 1.5)
        moved, _ = land_and_watch(rig, arm, CHANNEL)
    assert moved <= MOST_M
    said = caplog.text + capfd.readouterr().err
    assert "it goes round" in said or not barred
    assert "cannot land" not in said


@pytest.mark.long
@pytest.mark.parametrize(
    "motor, kind, value",
    [
        (f"joint_{number}", kind, value)
        for number in range(1, 7)
        for kind, value in (("nibble", int(Fault.OVER_CURRENT)), ("silent", True))
    ],
)
def test_an_arm_lands_with_a_motor_out(rig, motor, kind, value):
    """A limp wrist stands in the way of the fold, an arm with a limp shoulder lies on the table: it sinks there."""
    with arm_on(rig, CHANNEL) as arm:
        arm.move_to([0.1, 0.9, 0.9, -0.3, 0.1, 0.1], speed_rad_s=1.4)
        rig.fault(CHANNEL, motor, kind, value)
        arm.clock.sleep(1.5)  # what is limp has come to rest
        moved, speed = land_and_watch(rig, arm, CHANNEL, but=motor)
    assert moved <= MOST_M
    assert speed <= 2 * LANDING_SPEED_RAD_S


@pytest.mark.long
@pytest.mark.parametrize("motor", ["joint_2", "joint_3", "joint_4"])
def test_a_motor_that_obeys_and_is_not_heard_stays_where_it_was_sent(rig, motor):
    """Where it was heard last is no place to give way to."""
    with arm_on(rig, CHANNEL) as arm:
        arm.move_to([0.1, 0.9, 0.9, -0.3, 0.1, 0.1], speed_rad_s=1.4)
        rig.fault(CHANNEL, motor, "loss_rate", 1.0)
        arm.clock.sleep(0.6)
        moved, speed = land_and_watch(rig, arm, CHANNEL)
    assert moved <= MOST_M
    assert speed <= 2 * LANDING_SPEED_RAD_S


@pytest.mark.parametrize(
    "motor, rest",
    spread(
        [
            ("joint_2", [0.0, 0.6, 3.0, 0.0, 0.0, 0.0]),
            ("joint_2", [0.0, 0.9, 3.0, 0.0, 0.0, 0.0]),
            ("joint_2", [0.0, 1.0, 2.0, 0.0, 0.0, 0.0]),  # upright: it falls over late, and unseen
            ("joint_2", [0.0, 2.1, 2.5, 0.0, 0.0, 0.0]),
            ("joint_3", [0.0, 1.6, 2.6, 0.0, 0.0, 0.0]),
            ("joint_4", [0.0, 1.2, 1.2, 0.5, 0.0, 0.0]),
        ],
        0,
    ),
)
def test_a_joint_that_is_not_heard_sinks_as_slowly_as_the_others(motor, rest):
    """Its motor obeys: its set-point brings it down."""
    with rig_of("lockstep", arms=[CHANNEL]) as rig:
        rig.set_pose(CHANNEL, rest)
        with arm_on(rig, CHANNEL, rest_q_rad=rest) as arm:
            rig.fault(CHANNEL, motor, "loss_rate", 1.0)
            arm.clock.sleep(0.2)
            moved, speed = land_and_watch(rig, arm, CHANNEL)
    assert moved <= MOST_M
    assert speed <= 2 * LANDING_SPEED_RAD_S


@pytest.mark.long
@pytest.mark.parametrize("then", spread(["the cable is mended", "it goes on"], 1))
def test_an_arm_lands_of_which_no_reading_is_believed(rig, then):
    """Its motors obey all the same: without commands they would let go, with the arm in the air."""
    with arm_on(rig, CHANNEL) as arm:
        arm.move_to([0.1, 0.9, 0.9, -0.3, 0.1, 0.1], speed_rad_s=1.4)
        rig.fault(CHANNEL, None, "corrupt_rate", 0.4, all_bytes=True)
        arm.clock.sleep(3.0)
        if then == "the cable is mended":
            rig.clear_faults(CHANNEL)
        arm.clock.sleep(0.5)
        assert arm._session[CHANNEL].mode() is Mode.FAULT
        moved, speed = land_and_watch(rig, arm, CHANNEL)
    assert moved <= MOST_M
    assert speed <= 2 * LANDING_SPEED_RAD_S


def test_an_obstructed_landing_keeps_holding_and_says_so(rig, caplog, capfd):
    with arm_on(rig, CHANNEL) as arm:
        arm.move_to([0.0, 1.2, 1.0, 0, 0, 0], speed_rad_s=1.4)
        rig.push(CHANNEL, "link3", [70.0, 0, 60.0], 9.0)  # somebody leans against the arm
        arm.clock.sleep(0.2)
        begin = arm.clock.now()
        arm._session[CHANNEL].land()
        said = ""
        while "cannot land" not in said and arm.clock.now() < begin + 8.0:
            arm.clock.sleep(0.05)
            said += caplog.text + capfd.readouterr().err  # of a loop in this process, or in its own
        assert any(motor["enabled"] for motor in rig.state()["arms"][CHANNEL]["motors"].values())
        assert "it goes round" in said
        assert "cannot land" in said
        arm.land()  # once the way is free it ends by itself
        assert arm.clock.now() < begin + 30.0
    assert not any(motor["enabled"] for motor in rig.state()["arms"][CHANNEL]["motors"].values())
