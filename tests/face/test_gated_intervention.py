"""A leader with a gate takes over from a policy of LeRobot's RL stack while it is lifted."""

import time

import pytest
from lerobot.teleoperators.utils import TeleopEvents

from lerobot_robot_yam.rig.control import running_rig
from tests.face.devices.test_pairing import follower, leader

pytestmark = pytest.mark.alone


@pytest.mark.long
@pytest.mark.parametrize("gate", [{"gate": "auto"}, {"gate": "button", "gate_button": "bottom"}])
def test_a_gate_takes_over(tmp_path, gate):
    with running_rig(arms=["follower_left", "leader_left"]) as rig:
        teleop = leader(rig, tmp_path, action_space="delta", follower="follower_left", **gate)
        robot = follower(rig, tmp_path, use_degrees=True)
        teleop.connect()
        try:
            robot.connect()
            held = robot.get_observation()

            def intervenes(within_s, expected):
                until_s = time.monotonic() + within_s
                while time.monotonic() < until_s:
                    teleop.get_action()
                    robot.send_action(held)  # the policy's, whatever the leader does
                    if teleop.get_teleop_events()[TeleopEvents.IS_INTERVENTION] is expected:
                        return True
                    time.sleep(0.1)
                return False

            assert intervenes(1.0, False)
            for lifted in (True, False):
                if gate["gate"] == "button":
                    rig.press("leader_left", "record", 0.1)
                elif lifted:
                    rig.lift("leader_left", [0.0, 1.0, 1.0, -0.3, 0.0, 0.0], 1.0)
                else:
                    rig.bring_home("leader_left", seconds=1.0)
                assert intervenes(4.0, lifted)
                time.sleep(0.2)  # until the button is up again
        finally:
            robot.disconnect()
            teleop.disconnect()
