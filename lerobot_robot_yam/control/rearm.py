"""Re-arming of one arm in trouble: believe its motors again, enable those that have let go, hold where they are.

    ask      motors that have failed are asked several times: nothing is believed of one answer
    judge    refused: motors that contradict themselves, that swing, or that are answered for twice
    enable   clear the faults of those that have let go; nothing is sent to a silent motor: it may still hold its joint
    compare  refused: motors that had power all the time, and say to be where they cannot be
    hold     where they are by now, until all are well

It blocks for some ticks. Between its questions the loop commands the other arms (`JointInterface.on_wait`).
"""

from collections.abc import Sequence

import numpy as np

from lerobot_robot_yam.control.actuation import Actuation
from lerobot_robot_yam.control.laws import mit_laws
from lerobot_robot_yam.damiao.codec import SpecialCommand
from lerobot_robot_yam.damiao.tables import Fault, motor_type
from lerobot_robot_yam.errors import MotorError, YamError
from lerobot_robot_yam.state.faults import SILENT_S

_ANSWER_S = 0.006  # time for an answer; motors answer within a few ms, and the other arm gets no commands until then
_ASK_MOST = 12  # questions: one, or its answer, may get lost
_ASK_AT_LEAST = 3  # questions before motors are believed again: an answer may be somebody else's,
_AGREE = 2  # or garbled; so many have to agree
_DOUBLED = 2  # answers beyond the questions that tell of a second motor; one may be a late one
_ENABLE_ATTEMPTS = 2  # 27 ms each for seven motors, and the loop must not seem to hang
_HOLD_TICKS = 8  # in which a motor has to say that it is enabled: an answer may get lost
_SWINGS_RAD_S = 1.0  # a joint without torque that hangs still is slower
_TOO_FAST_RAD_S = 10.0  # in such a swing it is not armed: to be held at once would be a blow
_PUSHED_RAD = 0.5  # a hand or a load can push a joint this far from a set-point that it holds
_OFF_SHARE = 0.15  # share of a motor's range by which its torque may differ from what its command gives where it is


class Rearm:
    """Re-arms one arm."""

    def __init__(self, actuation: Actuation):
        self._actuation, self._interface, self._chain = actuation, actuation.interface, actuation.chain
        self._hardware = actuation.hardware
        self._where = f"{actuation.name} ({actuation.config.channel})"
        n = actuation.hardware.n
        self._believed_rad: np.ndarray = np.zeros(n)  # these four: before the motors were asked
        self._believed_rad_s: np.ndarray = np.zeros(n)
        self._limp: np.ndarray = np.zeros(n, dtype=bool)
        self._distrusted: np.ndarray = np.zeros(n, dtype=bool)

    def run(self) -> list[int]:
        """Re-arm; returns the motors that had failed.

        Raises:
            MotorError: a motor is where its joint cannot be, contradicts itself, moves too fast to be armed, two answer
                for it, or it still does not obey. Motors that were enabled are disabled again, unless only the last is
                the matter: then they hold. A motor that had kept its torque keeps it, and is not believed.
        """
        chain = self._chain
        failed = np.flatnonzero(~self._actuation.estimate.usable).tolist()
        self._believed_rad, self._believed_rad_s = chain.position_rad, chain.velocity_rad_s
        self._limp, self._distrusted = chain.fault != Fault.NORMAL, chain.distrusted
        counts = chain.duplicates - chain.lost, chain.feedback.rejected
        with chain.in_haste():
            chain.feedback.restart(failed)
            answers, fastest_rad_s = self._ask(failed)
            doubled = chain.duplicates - chain.lost - counts[0] >= _DOUBLED
            # Not even that a motor has let go is believed of one answer. To clear its fault would cut its torque.
            garbled = (answers < _AGREE) | (chain.feedback.rejected > counts[1])
            heard = self._judge(failed, bool(doubled.any()), garbled, fastest_rad_s)
            let_go = self._enable(heard)
        self._hold(failed, let_go)
        return failed

    def _ask(self, motors: Sequence[int]) -> tuple[np.ndarray, np.ndarray]:
        """Ask until each of these motors has answered often enough, or is silent.

        Returns:
            (n,) numbers of answers, and the largest speed that each tells now, rad/s.
        """
        chain = self._chain
        stamp_s = chain.stamp_s
        answers: np.ndarray = np.zeros(len(chain))
        fastest_rad_s: np.ndarray = np.zeros(len(chain))
        for count in range(_ASK_MOST):
            silent = chain.silence_s(chain.clock.now())[motors] >= SILENT_S
            if count >= _ASK_AT_LEAST and (silent | (answers[motors] >= _AGREE)).all():
                break
            chain.refresh(_ANSWER_S)
            news = chain.stamp_s > stamp_s
            answers, stamp_s = answers + news, chain.stamp_s
            fastest_rad_s = np.where(news, np.maximum(fastest_rad_s, np.abs(chain.velocity_rad_s)), fastest_rad_s)
            self._interface.on_wait()
        return answers, fastest_rad_s

    def _judge(self, motors: Sequence[int], doubled: bool, garbled: np.ndarray, fastest_rad_s: np.ndarray) -> list[int]:
        """Motors that are heard and can be believed again. Raises MotorError: names those that cannot be."""
        disbelieve = self._interface.disbelieve
        if doubled:  # which is ours, nobody knows
            disbelieve(motors, self._believed_rad)
            raise MotorError(f"{self._where}: motors answer twice; look for a second arm on the channel")
        silence_s = self._chain.silence_s(self._chain.clock.now())
        heard = [i for i in motors if silence_s[i] < SILENT_S]
        disbelieve([i for i in motors if i not in heard and self._distrusted[i]], self._believed_rad)
        too_fast = fastest_rad_s > _TOO_FAST_RAD_S
        too_fast[self._hardware.joints :] = False  # a gripper weighs next to nothing
        refused = [i for i in heard if too_fast[i] or garbled[i]]
        if refused:
            disbelieve(motors, self._believed_rad)
            swings_rad_s = np.maximum(np.abs(self._believed_rad_s), fastest_rad_s)
            raise self._refusal(refused, np.where(self._limp | too_fast, swings_rad_s, 0.0))
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

    def _enable(self, heard: Sequence[int]) -> list[int]:
        """Enable those that have let go, without torque; returns them."""
        chain, interface = self._chain, self._interface
        off = [i for i in heard if chain.fault[i] != Fault.NORMAL]
        chain.special(SpecialCommand.CLEAR, _ANSWER_S, off)
        interface.on_wait()
        interface.enable_some(off, _ANSWER_S, _ENABLE_ATTEMPTS, interface.on_wait)
        interface.estimate.read()
        try:
            interface.resolve([i for i in off if i < self._hardware.joints])  # without power it forgets its turn
            self._compare([i for i in heard if i not in off])  # with power it does not
        except YamError:
            chain.special(SpecialCommand.DISABLE, _ANSWER_S, off)
            interface.disbelieve([i for i in heard if i not in off], self._believed_rad)
            raise
        interface.estimate.read()
        return off

    def _compare(self, motors: Sequence[int]) -> None:
        """Compare what motors with power say with their last command.

        Raises:
            MotorError: some say to be where they cannot have got from where they were sent last, and from where they
                were believed. Or they work with another torque than their last command gives there,
                kp (q* − q) + kd (dq* − dq) + tau: a joint that was pushed away pulls back.
        """
        sent, estimate, specs = self._interface.sent, self._interface.estimate, self._hardware.motors
        low = high = sent[:, mit_laws.Q]
        if self._actuation.gripper is not None:  # what it presses on may have kept it from where it was sent
            believed = float(self._interface.position(self._believed_rad)[-1])
            low, high = low.copy(), high.copy()
            low[-1], high[-1] = min(low[-1], believed), max(high[-1], believed)
        gap = np.maximum(low - estimate.motor_q, estimate.motor_q - high)
        range_nm = np.array([motor_type(spec.type).torque_max_nm for spec in specs])
        spring_nm = sent[:, mit_laws.KP] * (sent[:, mit_laws.Q] - estimate.motor_q)
        damping_nm = sent[:, mit_laws.KD] * (sent[:, mit_laws.DQ] - estimate.motor_dq)
        gives_nm = np.clip(spring_nm + damping_nm + sent[:, mit_laws.TAU], -range_nm, range_nm)
        off = (gap > _PUSHED_RAD) | (np.abs(gives_nm - estimate.tau) > _OFF_SHARE * range_nm)
        told = "; ".join(
            f"{self._name(i)} still reads {estimate.motor_q[i]:.2f} rad and was sent to {sent[i, mit_laws.Q]:.2f}, and "
            f"works with {estimate.tau[i]:.1f} Nm where its command gives {gives_nm[i]:.1f}"
            for i in motors
            if off[i]
        )
        if told:
            advice = "check cables and plugs, let the arm land, and connect again"
            raise MotorError(f"{self._where}: {told}; {advice}")

    def _hold(self, failed: Sequence[int], let_go: Sequence[int]) -> None:
        """Hold where the arm is by now. Raises MotorError: a motor still does not obey."""
        arm = self._actuation
        asked = arm.setpoint.q.copy()
        arm.setpoint.start_joints()
        asked[let_go] = arm.setpoint.q[let_go]  # they have sagged
        for motor in set(failed) - set(let_go):  # it holds on to where it was sent, whether it is heard by now or not
            arm.setpoint.reseed(motor, float(asked[motor]))
        arm.compute_command(self._chain.clock.now(), 0.0)
        for _ in range(_HOLD_TICKS):
            finding = self._interface.exchange(arm.impedance.commands)
            if finding.trouble is None:
                return
        arm.setpoint.seed(asked)
        self._interface.disbelieve(np.flatnonzero(self._distrusted).tolist(), self._believed_rad)
        raise MotorError(f"{self._where}: cannot re-arm: {finding.message}")

    def _name(self, motor: int) -> str:
        spec = self._hardware.motors[motor]
        return f"{spec.name} (id {spec.can_id})"
