"""Leaders and their followers in lock-step, in one session: one clock, one control loop, no processes."""

import numpy as np

from lerobot_robot_yam.arm.config import LeadArmConfig
from lerobot_robot_yam.arm.leaders.lead_config import LeadConfig
from lerobot_robot_yam.session.arm_session import ArmSession
from tests.support.rigged import STOPS

LEADER, FOLLOWER = "leader_left", "follower_left"
PAIR = ((LEADER, FOLLOWER),)
BOTH = (*PAIR, ("leader_right", "follower_right"))
POSE = np.array([0.1, 1.0, 1.0, -0.3, 0.1, 0.1])


def arm_config(rig, channel, lead=None, **fields):
    """As `rigged.sim_config`, of an arm that may lead."""
    given = {"gravity_factor": [1.0] * 6, "interface": "yam_lockstep"}
    if channel.startswith("leader"):
        given |= {"gripper": "yam_teaching_handle", "start": "float"}
    else:
        given |= {"gripper_stops_rad": STOPS}
    return LeadArmConfig(name=channel, channel=channel, can_options={"rig": rig.name}, lead=lead, **given | fields)


def coupled_session(rig, follower_fields=None, pairs=PAIR, **lead):
    """A session of a pair or two, not yet started; `lead`: fields of `LeadConfig`."""
    leaders = [arm_config(rig, leader, LeadConfig(follower=follower, **lead)) for leader, follower in pairs]
    followers = [arm_config(rig, follower, **(follower_fields or {})) for _, follower in pairs]
    return ArmSession([*leaders, *followers], isolation="lockstep")


def sweep(rig, seconds, frequency_hz=0.5, rad=0.3):
    """Have the hand swing all joints of the leader about POSE, from 0.2 s on, with amplitude growing over 1 s."""
    t = np.arange(0.0, seconds, 0.01)
    swing = rad * np.sin(2.0 * np.pi * frequency_hz * t) * np.clip(t, 0.0, 1.0)
    rig.hand(LEADER, (t + 0.2).tolist(), (POSE + swing[:, None]).tolist())


def started(rig, follower_fields=None, fps=30, **lead):
    """A session under way with the leader held at POSE, and its caller; the follower has caught up."""
    session = coupled_session(rig, follower_fields, **lead)
    session.start()
    rig.hand(LEADER, [1.2], [POSE.tolist()])
    caller = Passing(session, fps)
    caller.run(2.0)
    return session, caller


class Passing:
    """A caller that passes the leaders' actions on, `fps` times a second, as LeRobot does.

    Attributes:
        given: (time, action) as passed on.
    """

    def __init__(self, session, fps=30, pairs=PAIR):
        self._session, self._period_s, self._pairs = session, 1 / fps, pairs
        self._next_s = session.clock.now()
        self.given = []

    def run(self, seconds, each_tick=lambda: None):
        """Let time pass tick by tick, and pass actions on."""
        session = self._session
        until_s = session.clock.now() + seconds
        while session.clock.now() < until_s:
            if session.clock.now() >= self._next_s:
                self._next_s += self._period_s
                self.pass_on()
            session.clock.sleep(0.004)
            each_tick()

    def pass_on(self):
        session = self._session
        for leads, follows in self._pairs:
            leader, follower = session[leads].newest(), session[follows].newest()
            action = follower.action if follower.coupled else leader.action
            if action is None:
                continue
            self.given.append((session.clock.now(), action))
            gripper = action[6] if len(action) > 6 else None
            session[follows].write_target(action[:6], gripper, leader=session.key(leads))

    def stall(self, seconds, each_tick=lambda: None):
        """Let time pass, and pass nothing on."""
        until_s = self._session.clock.now() + seconds
        while self._session.clock.now() < until_s:
            self._session.clock.sleep(0.004)
            each_tick()
        self._next_s = self._session.clock.now()
