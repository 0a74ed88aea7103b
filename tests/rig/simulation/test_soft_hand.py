"""A hand with mass, stiffness and damping, lifts and returns, and the forces that act on an arm."""

import math

import numpy as np
import pytest

from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.rig.lockstep.lockstep_rig import LockstepRig
from tests.support.rigged import arm_on, lockstep_rig, rig_of

LEADER, FOLLOWER = "leader_left", "follower_left"
RAISED = [0.2, 1.0, 0.9, -0.3, 0.1, 0.2]
rig = lockstep_rig(LEADER)


@pytest.fixture
def floating():
    """A leader without friction that floats, raised; its rig."""
    with rig_of("lockstep", arms=[LEADER], friction=0.0) as rig, arm_on(rig, LEADER, idle_kd=[0.0] * 6) as arm:
        rig.lift(LEADER, RAISED)
        arm.clock.sleep(2.0)
        yield rig, arm


def tool(rig, channel=LEADER):
    return np.array(rig.state()["arms"][channel]["tcp_site"]["pos"])


@pytest.mark.long
@pytest.mark.parametrize("stiffness", [300.0, 2000.0])
def test_a_soft_hand_is_a_spring(floating, stiffness):
    rig, arm = floating
    rig.hand(LEADER, [0.1], [RAISED], stiffness_n_m=stiffness, mass_kg=1.0, damping_ratio=1.0)
    arm.clock.sleep(2.0)
    before, rest = tool(rig), np.array(rig.forces(LEADER)["hand_n"])
    rig.push(LEADER, "tool", [0.0, 6.0, 0.0], 3.0)
    arm.clock.sleep(2.5)
    assert (tool(rig) - before)[1] == pytest.approx(6.0 / stiffness, rel=0.1)
    np.testing.assert_allclose(np.array(rig.forces(LEADER)["hand_n"]) - rest, [0.0, -6.0, 0.0], atol=0.4)


def period_and_decay(rig, arm, mass, ratio):
    """Of the swing of a spring of 300 N/m after a blow: seconds, and one amplitude over that a period before."""
    rig.hand(LEADER, [0.1], [RAISED], stiffness_n_m=300.0, mass_kg=mass, damping_ratio=ratio)
    arm.clock.sleep(3.0)
    middle = tool(rig)[1]
    rig.push(LEADER, "tool", [0.0, 20.0, 0.0], 0.02)
    times, ways = [], []
    for _ in range(600):
        arm.clock.sleep(0.004)
        times.append(rig.state()["sim_s"])
        ways.append(tool(rig)[1] - middle)
    way = np.array(ways)
    peaks = [i for i in range(1, len(way) - 1) if way[i] > way[i - 1] and way[i] >= way[i + 1] and way[i] > 2e-4]
    return times[peaks[1]] - times[peaks[0]], way[peaks[1]] / way[peaks[0]]


@pytest.mark.long
def test_a_heavier_hand_swings_more_slowly_and_damping_calms_it(floating):
    light, _ = period_and_decay(*floating, mass=0.5, ratio=0.05)
    heavy, little = period_and_decay(*floating, mass=2.0, ratio=0.05)
    _, much = period_and_decay(*floating, mass=2.0, ratio=0.2)
    # T = 2π √((m + what the arm weighs there) / k): the difference of squares knows nothing of the arm.
    assert (heavy**2 - light**2) * 300.0 / (4 * math.pi**2) == pytest.approx(1.5, rel=0.15)
    assert much < little < 0.95  # it feeds no energy in


def test_a_hand_without_stiffness_only_weighs_nothing_and_resists_nothing(floating):
    rig, arm = floating
    before = tool(rig)
    rig.hand(LEADER, [0.1], [RAISED], stiffness_n_m=0.0, mass_kg=2.0)
    arm.clock.sleep(1.0)
    assert np.abs(tool(rig) - before).max() < 0.02  # its weight does not pull the arm down
    rig.release(LEADER)
    assert rig.forces(LEADER)["hand_n"] == [0.0, 0.0, 0.0]


def test_a_lift_and_a_return_tell_of_their_ends(rig):
    with arm_on(rig, LEADER) as arm:
        rig.lift(LEADER, RAISED, 1.0, trigger=0.5)
        arm.clock.sleep(1.5)
        state = rig.state()["arms"][LEADER]
        assert state["held"] and state["trigger"] == pytest.approx(0.5)
        np.testing.assert_allclose(state["q"], RAISED, atol=0.05)
        rig.bring_home(LEADER, seconds=1.0)
        arm.clock.sleep(1.6)
        state = rig.state()["arms"][LEADER]
        assert not state["held"] and state["trigger"] == 0.0
        np.testing.assert_allclose(state["q"], 0.0, atol=0.1)
    kinds = [event["kind"] for event in rig.events() if event["kind"].startswith("hand")]
    assert kinds == ["hand_arrived", "hand_arrived"]


@pytest.mark.long
def test_a_soft_hand_leads_a_floating_follower_and_presses_it_onto_the_table():
    with rig_of("lockstep", arms=[FOLLOWER]) as rig, arm_on(rig, FOLLOWER) as arm:
        arm.move_to(RAISED, 1.0)
        arm.float()
        there = [0.4, 0.9, 0.8, -0.2, 0.0, 0.0]
        rig.lift(FOLLOWER, there)
        arm.clock.sleep(2.5)
        np.testing.assert_allclose(rig.state()["arms"][FOLLOWER]["q"], there, atol=0.08)
        assert rig.forces(FOLLOWER)["contacts"] == []
        rig.lift(FOLLOWER, [0.4, 2.5, 1.3, -0.9, 0.0, 0.0], 3.0, gives_way=False)  # below the table
        arm.clock.sleep(4.0)
        forces = rig.forces(FOLLOWER)
        assert forces["tool_n"][2] > 10.0
        assert forces["hand_n"][2] == pytest.approx(-forces["tool_n"][2], abs=6.0)  # dry friction takes the rest
        assert {contact["other"] for contact in forces["contacts"]} == {"table"}
        rig.release(FOLLOWER)


@pytest.mark.long
def test_a_soft_hand_gives_way_unless_it_is_told_not_to():
    with rig_of("lockstep", arms=[FOLLOWER]) as rig, arm_on(rig, FOLLOWER) as arm:
        arm.move_to(RAISED, 1.0)  # and holds there
        elsewhere = (np.array(RAISED) + [0.5, 0, 0, 0, 0, 0]).tolist()
        rig.lift(FOLLOWER, elsewhere, gives_way=False)
        arm.clock.sleep(2.5)
        assert rig.state()["arms"][FOLLOWER]["held"]
        rig.lift(FOLLOWER, elsewhere)
        arm.clock.sleep(1.5)
        state = rig.state()["arms"][FOLLOWER]
        assert not state["held"] and state["resists"]
        assert [event["kind"] for event in rig.events()].count("hand_gave_way") == 1


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"stiffness_n_m": float("nan")}, "stiffness_n_m: expected a finite number"),
        ({"stiffness_n_m": -1.0}, "stiffness_n_m of a hand is a number from 0 to 5000"),
        ({"mass_kg": 0.0}, "mass_kg of a hand is a number from 0.05 to 5"),
        ({"damping_ratio": "much"}, "damping_ratio"),
        ({"gives_way": 1}, "true or false"),
    ],
)
def test_what_a_hand_refuses(rig, values, message):
    with pytest.raises(ConfigError, match=message):
        rig.hand(LEADER, [1.0], [RAISED], **values)
    assert not rig.state()["arms"][LEADER]["held"]


def test_pushes_and_hands_add_up():
    rig = LockstepRig(arms=[FOLLOWER])
    device = rig.device
    rig.push(FOLLOWER, "tool", [0.0, 0.0, 5.0], 0.1)
    rig.hand(FOLLOWER, [0.0], [rig.state()["arms"][FOLLOWER]["q"]], mass_kg=1.0)
    rig.sleep(0.02)
    body = int(device.world.model.site(f"{FOLLOWER}/tcp_site").bodyid[0])
    hand_z = rig.forces(FOLLOWER)["hand_n"][2] + 9.81
    assert device.world.data.xfrc_applied[body, 2] == pytest.approx(5.0 + hand_z, abs=0.5)
    rig.sleep(0.3)
    rig.release(FOLLOWER)
    rig.close()
    np.testing.assert_array_equal(device.world.data.xfrc_applied[body], 0.0)
