"""One motor by the arrow keys. It is the only action of yam-motors that energises anything.

While it runs the motor has a watchdog: if this program is killed, the motor lets go after its time-out.
"""

import argparse
import math

from lerobot_robot_yam.arm.joint_map import resolve_turn
from lerobot_robot_yam.arm.mounting import gripper_id
from lerobot_robot_yam.arm.profile_files import load_arm
from lerobot_robot_yam.arm.resolved_arm import ResolvedArm
from lerobot_robot_yam.commands.lib.arm_command import arm_config, ask, tell
from lerobot_robot_yam.commands.lib.key_terminal import QUIT, KeyTerminal, key_terminal
from lerobot_robot_yam.commands.lib.motor.motor_bench import SAFE_COUNTS, MotorBench
from lerobot_robot_yam.commands.lib.motor.motor_knob import HELP, Knob
from lerobot_robot_yam.control.preflight.arm_inspection import refuse_stopped
from lerobot_robot_yam.control.preflight.role import answering_gripper
from lerobot_robot_yam.damiao.codec import SpecialCommand, encode_mit, ranges_of, unpack_feedback
from lerobot_robot_yam.damiao.registers import Register
from lerobot_robot_yam.damiao.settings.motor_memory import MotorState, read_state
from lerobot_robot_yam.damiao.tables import TIMEOUT_COUNT_S, ControlMode, Fault, fault_text, motor_type
from lerobot_robot_yam.errors import ConfigError, MotorError
from lerobot_robot_yam.state.emergency_stop import EmergencyStop
from lerobot_robot_yam.system.signals import undisturbed

_PERIOD_S = 0.01
_LONGEST_S = 0.03  # of a period that the set-point makes up for
_SHOWN_S = 0.1
_SILENT_S = 0.2
_AT_REST_RAD = 0.15
_TORQUE_SHARE = 0.3  # of the motor's torque that the console asks for at most
_LET_DOWN_S, _LET_DOWN_KD, _DISABLES = 1.5, 5.0, 3


def console(args: argparse.Namespace, bench: MotorBench) -> int:
    """`yam-motors console`."""
    if not args.motor or len(args.motor) != 1:
        raise ConfigError("name one motor (--motor joint_6)")
    if not 0.0 < args.range <= math.pi:
        raise ConfigError(f"the motor may turn by 0 to {math.pi:.2f} rad from where it is, not by {args.range:g}")
    (can_id,) = bench.ids(args.motor)
    name = bench.name(can_id)
    refuse_stopped(name, EmergencyStop())
    others = [other for other in bench.names if other != can_id and bench.access.replies(other, Register.ESC_ID)]
    bench.require_settable([can_id, *others])
    _require_watchdog(bench, can_id)
    kind = bench.scan([can_id])[can_id].kind
    most_nm = _TORQUE_SHARE * motor_type(kind).torque_max_nm  # an unknown type is refused
    _confirm(args, bench, can_id)
    refuse_stopped(name, EmergencyStop())  # again: the person may have taken their time
    bench.require_settable([can_id, *others])
    state = read_state(bench.access, can_id)
    if state is None:
        raise MotorError(f"{bench.channel}: {name} gives no feedback; nothing was energised")
    knob = Knob(kind, state.position_rad, args.range, most_nm)
    _turn(_Motor(bench, can_id, kind), knob)
    tell(f"\n{name} is limp")
    return 0


def _require_watchdog(bench: MotorBench, can_id: int) -> None:
    """Refuse a motor that goes on for longer than an arm's motors do when this program dies. Raises MotorError."""
    counts = bench.access.read(can_id, Register.TIMEOUT)
    if counts is None or not 0 < counts <= SAFE_COUNTS:
        lasts = f"for {counts * TIMEOUT_COUNT_S:g} s" if counts else "for ever"
        raise MotorError(
            f"{bench.channel}: {bench.name(can_id)} goes on {lasts} if this program dies; set its time-out first "
            f"(yam-motors timeout {bench.config.on_command_line} 0.4)"
        )


def _turn(motor: "_Motor", knob: Knob) -> None:
    """Energise the motor, turn it by the keys, and let it down however that ends."""
    with key_terminal() as terminal:
        try:
            motor.enable()
            tell(HELP)
            _follow_keys(motor, knob, terminal)
        finally:
            with undisturbed("the joint is being let down"):
                motor.let_down()


def _confirm(args: argparse.Namespace, bench: MotorBench, can_id: int) -> None:
    """Say what will be energised and whether the arm hangs in the air, and ask."""
    name, off = bench.name(can_id), _off_rest(args, bench)
    tell(
        f"HAZARD: this energises {name} alone; every other motor of the arm stays limp. When it ends, or is killed, "
        f"{name} goes limp, too. Keep hands off, and the switch of the supply within reach."
    )
    word = "enable"
    if off:
        word = "in the air"
        tell(f"THE ARM HANGS IN THE AIR OR IS HELD UP: {off}. It falls when it is let go: support it all the time.")
    if ask(f"Type {word} to energise {name}:") != word:
        raise ConfigError("not confirmed; nothing was energised")


def _off_rest(args: argparse.Namespace, bench: MotorBench) -> str:
    """Which joints are not where the arm lies by itself; empty when it lies."""
    gripper = answering_gripper(bench.bus, bench.channel, gripper_id(load_arm(bench.config.arm)))
    hardware = ResolvedArm(arm_config(args, gripper=gripper))
    off = []
    for index, spec in enumerate(hardware.motors[: hardware.joints]):
        state = read_state(bench.access, spec.can_id)
        if state is None:
            off.append(f"{spec.name} does not answer")
            continue
        q = state.position_rad * hardware.direction[index]
        low, high = hardware.arm.joint_limits_rad[index]
        try:
            q += resolve_turn(bench.channel, spec.name, q, low, high)
        except MotorError:
            off.append(f"{spec.name} reads {q:+.2f} rad, outside its range")
            continue
        if abs(q - hardware.rest_q[index]) > _AT_REST_RAD:
            off.append(f"{spec.name} is {q - hardware.rest_q[index]:+.2f} rad from rest")
    return ", ".join(off)


class _Motor:
    """The motor that is energised."""

    def __init__(self, bench: MotorBench, can_id: int, kind: str):
        self.bench, self.can_id = bench, can_id
        self.where = f"{bench.channel}: {bench.name(can_id)}"
        self.clock = bench.access.port.clock
        self._kind, self._ranges = kind, ranges_of(kind)
        self._master = int(bench.access.find(can_id)[0].value)

    def enable(self) -> None:
        """Raises MotorError: it does not take the mode."""
        self.bench.access.write_and_check(self.can_id, Register.CTRL_MODE, ControlMode.MIT)
        self.bench.access.special(self.can_id, SpecialCommand.ENABLE)

    def exchange(self, data: bytes) -> MotorState | None:
        """Send a command; its answer, None without one."""
        answer = self.bench.access.exchange(self.can_id, self._master, self.can_id, data, _PERIOD_S)
        return None if answer is None else MotorState(*unpack_feedback(self._ranges, answer)[1:])

    def let_down(self) -> None:
        """Damp it for a while, and switch it off.

        Raises:
            MotorError: it is still energised.
        """
        access, damping = self.bench.access, encode_mit(self._kind, 0.0, 0.0, 0.0, _LET_DOWN_KD, 0.0)
        deadline = self.clock.now() + _LET_DOWN_S
        while self.clock.now() < deadline:
            state = self.exchange(damping)
            if state is not None and state.fault != Fault.NORMAL:
                break
            self.clock.sleep(_PERIOD_S)
        for _ in range(_DISABLES):
            access.special(self.can_id, SpecialCommand.DISABLE)
            state = read_state(access, self.can_id)
            if state is not None and state.fault != Fault.NORMAL:
                return
        raise MotorError(f"{self.where} MAY STILL BE ENERGISED: support the arm, and switch its power off")


def _follow_keys(motor: _Motor, knob: Knob, terminal: KeyTerminal) -> None:
    """Send the knob's commands until `q` is typed or the terminal is closed.

    Raises:
        MotorError: the motor is silent, or reports a fault.
    """
    stop, q, stopped = EmergencyStop(), knob.start_rad, False
    heard_s = sent_s = motor.clock.now()
    shown_s = -math.inf
    while not terminal.gone:
        before, stopped = stopped, stop.latched
        for key in terminal.keys(_PERIOD_S):
            if key in QUIT:
                return
            if not stopped:
                knob.press(key)
        if stopped and not before:
            knob.stay()
        last_s, sent_s = sent_s, motor.clock.now()  # keys that come fast make the loop fast
        state = motor.exchange(knob.command(q, min(sent_s - last_s, _LONGEST_S)))
        now = motor.clock.now()
        if state is None and now - heard_s > _SILENT_S:
            raise MotorError(f"{motor.where} has fallen silent; its time-out lets it go")
        if state is None:
            continue
        q, heard_s = state.position_rad, now
        if state.fault != Fault.NORMAL:
            raise MotorError(f"{motor.where} has let go: {fault_text(state.fault)}")
        if now - shown_s > _SHOWN_S:
            shown_s = now
            tell(_line(knob, state, stopped), end="")


def _line(knob: Knob, state: MotorState, stopped: bool) -> str:
    gains = f"kp {knob.kp:.1f} kd {knob.kd:.2f}"
    measured = f"q {state.position_rad:+.3f} rad  dq {state.velocity_rad_s:+.2f}  tau {state.torque_nm:+.2f} Nm"
    heat = f"{state.temp_mos_c}/{state.temp_rotor_c} °C"
    end = "EMERGENCY STOP" if stopped else fault_text(state.fault)
    return f"\rtarget {knob.target:+.3f} rad step {knob.step:g}  {gains}  {measured}  {heat}  {end} "
