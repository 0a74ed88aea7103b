"""Re-arming of an arm in fault, tick by tick: check the replies of failed motors, re-enable limp motors, hold.

    listen   collect replies of failed motors in a separate store, unused until checked: a single reply proves nothing
    judge    reject motors with contradictory replies, swinging motors, and ids to which two motors reply
    compare  reject motors that kept their torque and report an impossible position or torque
    enable   clear the faults of limp motors and enable them; a silent motor gets only commands, as it may still hold
    hold     hold the measured pose until all motors are well

At every tick the arm is commanded as before; motors being enabled are commanded zero torque.
"""

from collections.abc import Generator, Iterator, Sequence

import numpy as np

from lerobot_robot_yam.control.actuation import Actuation
from lerobot_robot_yam.control.joints.enabling import enable
from lerobot_robot_yam.control.joints.joint_interface import JointInterface
from lerobot_robot_yam.control.laws import mit_laws
from lerobot_robot_yam.control.safety import torque_check
from lerobot_robot_yam.damiao.receiver import FeedbackStore
from lerobot_robot_yam.damiao.tables import Fault, motor_type
from lerobot_robot_yam.errors import MotorError

_LISTEN_S = 0.05  # maximum time to listen, s: replies may get lost; the adapter's delay is added
_LISTEN_TICKS = 3  # minimum number of ticks to listen: a reply may be another motor's
_AGREE = 2  # required number of agreeing replies: one reply may be garbled
_MISSED = 10  # consecutive commands without a reply after which a motor counts as silent
_DOUBLED = 2  # surplus replies that indicate a second motor with the same id; one reply may be late
_HOLD_TICKS = 8  # maximum number of ticks until every motor is well
_SWINGS_RAD_S = 1.0  # speed above which a limp joint counts as swinging
_TOO_FAST_RAD_S = 10.0  # maximum speed of a joint for re-arming: stopping a faster joint at once would be a blow
_PUSHED_RAD = 0.5  # maximum distance by which a hand or load can push a holding joint off its set-point


class Rearm:
    """Re-arming of one arm."""

    def __init__(self, actuation: Actuation, interface: JointInterface):
        self._actuation, self._interface, self._chain = actuation, interface, interface.chain
        self._hardware = actuation.hardware
        self._where = f"{actuation.name} ({actuation.config.channel})"

    def run(self) -> Generator[None, None, list[int]]:
        """Re-arm, one step per tick; return the motors that had failed.

        Raises:
            MotorError: a motor's replies are impossible or contradictory, a motor moves too fast, or two motors share
                an id (in these cases nothing has changed); or a motor still does not obey, and the others hold.
        """
        arm, chain, trial = self._actuation, self._chain, self._chain.listen()
        failed = np.flatnonzero(~arm.estimate.usable).tolist()
        try:
            heard = yield from self._listen(failed, trial)
        finally:
            chain.stop_listening()
        off = [i for i in heard if trial.fault[i] != Fault.NORMAL]
        self._compare([i for i in heard if i not in off], trial)
        chain.feedback.adopt(trial, heard)
        arm.estimate.read()
        self._interface.resolve([i for i in off if i < self._hardware.joints])  # unpowered motors lose their turn
        arm.estimate.read()
        yield from self._enable(off)
        for _ in range(_HOLD_TICKS):
            yield
            if arm.finding.trouble is None:
                break
        else:
            raise MotorError(f"{self._where}: cannot re-arm: {arm.finding.message}")
        asked = arm.setpoint.q.copy()
        arm.setpoint.start_joints()
        for motor in set(failed) - set(off):  # these motors still hold at their last command
            arm.setpoint.reseed(motor, float(asked[motor]))
        return failed

    def _listen(self, motors: Sequence[int], trial: FeedbackStore) -> Generator[None, None, list[int]]:
        """Listen until each of `motors` has replied often enough, or is silent; return the motors that reply.

        Raises:
            MotorError: replies are not credible; the message names the motors.
        """
        chain = self._chain
        believed_rad_s, limp = chain.velocity_rad_s, chain.fault != Fault.NORMAL
        doubled_before, stamp_s = chain.duplicates - chain.lost, trial.stamp_s
        until_s = chain.clock.now() + _LISTEN_S + 2.0 * chain.round_trip.one_way_s
        answers: np.ndarray = np.zeros(len(chain))
        fastest_rad_s: np.ndarray = np.zeros(len(chain))
        ticks = 0
        while True:
            silent = chain.missed >= _MISSED
            enough = (silent | (answers >= _AGREE))[motors].all() and ticks >= _LISTEN_TICKS
            if enough or chain.clock.now() > until_s:
                break
            yield
            ticks += 1
            news = trial.stamp_s > stamp_s
            answers, stamp_s = answers + news, trial.stamp_s
            fastest_rad_s = np.where(news, np.maximum(fastest_rad_s, np.abs(trial.velocity_rad_s)), fastest_rad_s)
        if (chain.duplicates - chain.lost - doubled_before >= _DOUBLED).any():  # unknown which replies are right
            raise MotorError(f"{self._where}: motors answer twice; look for a second arm on the channel")
        too_fast = fastest_rad_s > _TOO_FAST_RAD_S
        too_fast[self._hardware.joints :] = False  # a gripper has hardly any mass
        # A single reply does not prove that a motor is limp, and clearing a fault would cut the motor's torque.
        garbled = (answers < _AGREE) | (trial.rejected > 0)
        heard = [i for i in motors if not silent[i]]
        refused = [i for i in heard if too_fast[i] or garbled[i]]
        if refused:
            swings_rad_s = np.maximum(np.abs(believed_rad_s), fastest_rad_s)
            raise self._refusal(refused, np.where(limp | too_fast, swings_rad_s, 0.0))
        return heard

    def _refusal(self, refused: Sequence[int], swings_rad_s: np.ndarray) -> MotorError:
        """Return an error naming swinging motors, or if there are none, the motors with contradictory replies.

        A joint that swings against its stop also causes contradictory replies. swings_rad_s: (n,) speeds of limp
        motors, else 0.
        """
        swinging = [i for i in refused if i < self._hardware.joints and swings_rad_s[i] > _SWINGS_RAD_S]
        if swinging:
            what = ", ".join(f"{self._name(i)} still swings, at {swings_rad_s[i]:.0f} rad/s" for i in swinging)
            remedy = "wait until it hangs still, and re-arm again; if it does, check cable, plugs and termination"
        else:
            names = ", ".join(map(self._name, refused))
            what = f"the answers of {names} contradict each other, or come too seldom"
            remedy = "check cable, plugs and termination, and re-arm again"
        return MotorError(f"{self._where}: {what}; {remedy}")

    def _compare(self, motors: Sequence[int], trial: FeedbackStore) -> None:
        """Compare the readings of `motors`, which kept their torque, with their last commands.

        Raises:
            MotorError: a motor reports a position that is unreachable from its last command, or a torque that differs
                from the law of its last command, kp (q* − q) + kd (dq* − dq) + tau: a displaced joint pulls back.
        """
        sent, specs, direction = self._interface.sent, self._hardware.motors, self._hardware.direction
        q, dq, tau = self._interface.position(trial.position_rad), trial.velocity_rad_s, trial.torque_nm * direction
        low = high = sent[:, mit_laws.Q]
        if self._actuation.gripper is not None:  # an object may keep the gripper off its target
            believed = float(self._actuation.estimate.motor_q[-1])
            low, high = low.copy(), high.copy()
            low[-1], high[-1] = min(low[-1], believed), max(high[-1], believed)
        gap = np.maximum(low - q, q - high)
        range_nm = np.array([motor_type(spec.type).torque_max_nm for spec in specs])
        gives_nm = np.clip(mit_laws.motor_torque(sent, q, dq * direction), -range_nm, range_nm)
        soft = sent[:, mit_laws.KP] * _PUSHED_RAD < torque_check.SHARE * range_nm  # a hand may have moved it anywhere
        off = ((gap > _PUSHED_RAD) & ~soft) | (np.abs(gives_nm - tau) > torque_check.SHARE * range_nm)
        told = "; ".join(
            f"{self._name(i)} still reads {q[i]:.2f} rad and was sent to {sent[i, mit_laws.Q]:.2f}, and "
            f"works with {tau[i]:.1f} Nm where its command gives {gives_nm[i]:.1f}"
            for i in motors
            if off[i]
        )
        if told:
            advice = "check cables and plugs, let the arm land, and connect again"
            raise MotorError(f"{self._where}: {told}; {advice}")

    def _enable(self, motors: Sequence[int]) -> Iterator[None]:
        """Re-enable limp motors at zero torque; their set-points track the joints while these sag."""
        arm = self._actuation
        joints = [i for i in motors if i < self._hardware.joints]
        arm.limp = list(motors)
        try:
            for _ in enable(self._interface, motors, clear=True):
                for joint in joints:
                    arm.setpoint.start_one(joint)
                yield
        finally:
            arm.limp = []

    def _name(self, motor: int) -> str:
        spec = self._hardware.motors[motor]
        return f"{spec.name} (id {spec.can_id})"
