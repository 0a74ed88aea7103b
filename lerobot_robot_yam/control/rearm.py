"""Re-arming of one arm in trouble, over ticks: judge what its failed motors say, enable those that have let go, hold.

    listen   what failed motors say is kept apart, and not used, until it is judged: nothing is believed of one answer
    judge    refused: motors that contradict themselves, that swing, or that are answered for twice
    compare  refused: motors that had power all the time, and say to be where they cannot be
    enable   clear the faults of those that have let go; nothing but commands goes to a silent motor: it may still hold
    hold     where they are by now, until all are well

At every tick the arm is commanded as before; a motor that is being enabled is commanded no torque.
"""

from collections.abc import Generator, Iterator, Sequence

import numpy as np

from lerobot_robot_yam.control.actuation import Actuation
from lerobot_robot_yam.control.joints.joint_interface import JointInterface
from lerobot_robot_yam.control.laws import mit_laws
from lerobot_robot_yam.damiao.receiver import FeedbackStore
from lerobot_robot_yam.damiao.tables import Fault, motor_type
from lerobot_robot_yam.errors import MotorError

_LISTEN_S = 0.05  # longest time to listen, s, beyond what the adapter takes: an answer may get lost
_LISTEN_TICKS = 3  # shortest: an answer may be another motor's,
_AGREE = 2  # or garbled; so many have to agree
_MISSED = 10  # questions in a row without an answer: the motor is silent
_DOUBLED = 2  # answers beyond the questions that tell of a second motor; one may be a late one
_HOLD_TICKS = 8  # within which every motor has to be well
_SWINGS_RAD_S = 1.0  # a joint without torque that hangs still is slower
_TOO_FAST_RAD_S = 10.0  # in such a swing it is not armed: to be held at once would be a blow
_PUSHED_RAD = 0.5  # a hand or a load can push a joint this far from a set-point that it holds
_OFF_SHARE = 0.15  # share of a motor's range by which its torque may differ from what its command gives where it is


class Rearm:
    """Re-arms one arm."""

    def __init__(self, actuation: Actuation, interface: JointInterface):
        self._actuation, self._interface, self._chain = actuation, interface, interface.chain
        self._hardware = actuation.hardware
        self._where = f"{actuation.name} ({actuation.config.channel})"

    def run(self) -> Generator[None, None, list[int]]:
        """Re-arm, one step a tick; returns the motors that had failed.

        Raises:
            MotorError: a motor is where its joint cannot be, contradicts itself, moves too fast to be armed, two answer
                for it: then nothing has changed. Or one still does not obey: then those hold that do.
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
        self._interface.resolve([i for i in off if i < self._hardware.joints])  # without power it forgets its turn
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
        for motor in set(failed) - set(off):  # it holds on to where it was sent
            arm.setpoint.reseed(motor, float(asked[motor]))
        return failed

    def _listen(self, motors: Sequence[int], trial: FeedbackStore) -> Generator[None, None, list[int]]:
        """Listen until each of these motors has answered often enough, or is silent; returns those that are heard.

        Raises:
            MotorError: names motors that cannot be believed.
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
        if (chain.duplicates - chain.lost - doubled_before >= _DOUBLED).any():  # which is ours, nobody knows
            raise MotorError(f"{self._where}: motors answer twice; look for a second arm on the channel")
        too_fast = fastest_rad_s > _TOO_FAST_RAD_S
        too_fast[self._hardware.joints :] = False  # a gripper weighs next to nothing
        # Not even that a motor has let go is believed of one answer. To clear its fault would cut its torque.
        garbled = (answers < _AGREE) | (trial.rejected > 0)
        heard = [i for i in motors if not silent[i]]
        refused = [i for i in heard if too_fast[i] or garbled[i]]
        if refused:
            swings_rad_s = np.maximum(np.abs(believed_rad_s), fastest_rad_s)
            raise self._refusal(refused, np.where(limp | too_fast, swings_rad_s, 0.0))
        return heard

    def _refusal(self, refused: Sequence[int], swings_rad_s: np.ndarray) -> MotorError:
        """Error that names motors that swing, or whose answers do not fit: one that swings may meet its stop.

        swings_rad_s: (n,) speed of those without torque, else 0.
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
        """Compare what motors with power say with their last command.

        Raises:
            MotorError: some say to be where they cannot have got from where they were sent last, and from where they
                were believed. Or they work with another torque than their last command gives there,
                kp (q* − q) + kd (dq* − dq) + tau: a joint that was pushed away pulls back.
        """
        sent, specs, direction = self._interface.sent, self._hardware.motors, self._hardware.direction
        q, dq, tau = self._interface.position(trial.position_rad), trial.velocity_rad_s, trial.torque_nm * direction
        low = high = sent[:, mit_laws.Q]
        if self._actuation.gripper is not None:  # what it presses on may have kept it from where it was sent
            believed = float(self._actuation.estimate.motor_q[-1])
            low, high = low.copy(), high.copy()
            low[-1], high[-1] = min(low[-1], believed), max(high[-1], believed)
        gap = np.maximum(low - q, q - high)
        range_nm = np.array([motor_type(spec.type).torque_max_nm for spec in specs])
        spring_nm = sent[:, mit_laws.KP] * (sent[:, mit_laws.Q] - q)
        damping_nm = sent[:, mit_laws.KD] * (sent[:, mit_laws.DQ] - dq * direction)
        gives_nm = np.clip(spring_nm + damping_nm + sent[:, mit_laws.TAU], -range_nm, range_nm)
        off = (gap > _PUSHED_RAD) | (np.abs(gives_nm - tau) > _OFF_SHARE * range_nm)
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
        """Enable motors that have let go, without torque; their set-points are where they sag to."""
        arm = self._actuation
        joints = [i for i in motors if i < self._hardware.joints]
        arm.limp = list(motors)
        try:
            for _ in self._interface.enable(motors, clear=True):
                for joint in joints:
                    arm.setpoint.start_one(joint)
                yield
        finally:
            arm.limp = []

    def _name(self, motor: int) -> str:
        spec = self._hardware.motors[motor]
        return f"{spec.name} (id {spec.can_id})"
