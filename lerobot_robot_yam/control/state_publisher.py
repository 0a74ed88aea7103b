"""The control loop's side of an arm's shared blocks: publish states, read targets and requests."""

import logging
import math
import os

import numpy as np

from lerobot_robot_yam.control.arm_controller import ArmController
from lerobot_robot_yam.control.gripper.gripper_stops import GripperStops
from lerobot_robot_yam.control.gripper.handle_reader import HandleState
from lerobot_robot_yam.damiao.chain import MotorChain
from lerobot_robot_yam.errors import YamError
from lerobot_robot_yam.state.about import forget_about, tell_about
from lerobot_robot_yam.state.faults import Trouble
from lerobot_robot_yam.state.modes import Mode
from lerobot_robot_yam.state.records import EACH_TICK, OWNER, STATE_DTYPE, BlockPair, Led, Request, state_path

logger = logging.getLogger(__name__)

_MEASURED = (
    "q",
    "dq",
    "tau",
    "setpoint",
    "motor_stamp_s",
    "stamp_doubt_s",
    "temp_mos_c",
    "temp_rotor_c",
    "offset_rad",
)  # NaN at first
_ACTION = ("action", "action_dq", "action_stamp_s")
_LOSS_S = 0.4  # time after a lost reply for which stamps are uncertain, s: the windows of `RoundTrip`, and a margin
_SELDOM = ("fault", "distrusted", "lost")
_EACH_TICK_AT, _EACH_TICK = EACH_TICK


class ControllerBlocks:
    """Connection between one controller and its two shared blocks. Other programs can read the states.

    Args:
        controller: the arm's controller.
        key: channel key under which the states are published.
        pair: the arm's state block and command block.
        adopt: last state of a dead loop, whose block stays in use, so that readers are not interrupted; or None.
    """

    def __init__(self, controller: ArmController, key: str, pair: BlockPair, adopt: np.ndarray | None = None):
        self._controller, self._key = controller, key
        self._states, self._commands = pair
        try:
            self._states.publish(state_path(key))
        except (OSError, YamError) as error:  # full disk, or files removed by a log-out
            logger.warning("%s: no other program can watch the arm: %s", controller.name, error)
        tell_about(key, controller.config)
        self._bytes = bytearray(STATE_DTYPE.itemsize)
        self._record: np.ndarray = np.frombuffer(self._bytes, STATE_DTYPE).reshape(())
        for field in (*_MEASURED, "gripper_stops_rad", *_ACTION):
            self._record[field] = np.nan
        if adopt is not None:
            self._record[()] = adopt
            self._states.adopt()
            for field in _ACTION:  # the stand-by leads no follower
                self._record[field] = np.nan
            self._record["gate"] = self._record["coupled_to"] = 0
        hardware = controller.actuation.hardware
        self._record["joints"], self._record["motors"] = hardware.joints, hardware.n
        self._owner = self._record["owner_pid"] = os.getpid()
        self._first_tick = int(self._record["tick"])
        self._seen = 0
        self._asked = self._answered = int(self._record["request_sequence"])
        self._ended = False
        self._lost, self._lost_s = 0, -math.inf  # number of lost replies, and when it last grew, s
        self.published_mode = Mode.OFFLINE
        self._coupled = False  # whether coupled, in the last published state
        self._slots = hardware.slots
        # Views of the record: looking up a field by name takes longer than filling the field.
        self._measured = [self._record[field][self._slots] for field in _MEASURED]
        self._sunk = self._record["sunk"][: hardware.joints]
        self._handle = _packed(controller.handle)
        self._well = False  # whether all motors were well in the last published state
        self._seldom: tuple | None = None  # rarely changing values in the last published state

    def read_target(self, now: float) -> None:
        """Pass the caller's new requests and targets to the controller."""
        sequence, status = self._commands.sequence(), self._controller.status
        if sequence == self._seen or status.busy:
            return
        command = self._commands.glance()  # does not wait: a caller may hang or die while writing
        if command is None:
            return
        self._seen = sequence
        record, controller = self._record, self._controller
        if command["request_sequence"] > self._asked:  # older requests count as withdrawn
            self._asked, status.refusal = int(command["request_sequence"]), ""
            controller.coupling.end()
            try:
                request = Request(int(command["request"]))
                if request is Request.GAINS:
                    controller.change_gains(command["own_kp"][self._slots], command["own_kd"][self._slots])
                else:
                    controller.request(request, now)
            except YamError as error:
                status.refusal = str(error)
        if command["target_sequence"] > record["target_sequence"]:
            record["target_sequence"] = command["target_sequence"]
            slots = self._slots
            dq = command["dq"][slots]
            velocity = None if np.isnan(dq).any() else dq
            age_s = float(now - command["target_stamp_s"])
            if age_s <= controller.config.command_timeout_s:
                led = Led(command["leader"].item().decode(), int(command["button"]), int(command["presses"]))
                if led.leader:
                    controller.coupling.permit(led, now - age_s)
                    if controller.coupling.can_follow(now):
                        return
                    controller.coupling.give_way()
                else:
                    controller.coupling.end()
                q, kp, kd = command["q"][slots], command["kp"][slots], command["kd"][slots]
                if controller.set_target(q, now, velocity, kp, kd, age_s):
                    record["action"][slots] = q

    def publish(self, now: float, tick: int) -> None:
        """Write the arm's state at this tick. After OFF has been published, nothing is written."""
        if self._ended:
            return
        status, arm = self._controller.status, self._controller.actuation
        chain, estimate = arm.chain, arm.estimate
        self._ended = status.mode is Mode.OFF
        self.published_mode = status.mode
        if not self._ended:  # once an arm is off, its handle is not read any more
            self._handle = _packed(self._controller.handle)
        _EACH_TICK.pack_into(
            self._bytes,
            _EACH_TICK_AT,
            now,
            self._first_tick + tick,
            min(chain.asked_s.tolist()),
            status.mode,
            status.limited,
            arm.impedance.own_gains,
            arm.gripper is not None and arm.gripper.stalled,
            *self._handle,
        )
        q, dq, tau, setpoint, stamps, doubt, mos, rotor, offset = self._measured
        q[...], dq[...], tau[...] = estimate.q, estimate.dq, estimate.tau
        setpoint[...], stamps[...] = arm.setpoint.asked[0], chain.stamp_s
        doubt[...] = self._stamp_doubt_s(chain, now)
        mos[...], rotor[...], offset[...] = chain.temp_mos_c, chain.temp_rotor_c, self._controller.interface.offset_rad
        self._sunk[...] = arm.sunk
        if not (self._well and chain.all_normal and chain.all_answered):
            self._well = chain.all_normal and chain.all_answered
            for field in _SELDOM:
                self._record[field][self._slots] = getattr(chain, field)
        if self._answered != self._asked and not status.busy:
            self._answered = self._record["request_sequence"] = self._asked
            self._record["request_refused"] = bool(status.refusal)
            self._record["refusal"] = status.refusal.encode()[:400]
        self._note_action()
        self._note_seldom(None if arm.gripper is None else arm.gripper.stops, status.trouble, status.message)
        self._states.write_bytes(self._bytes)

    def _stamp_doubt_s(self, chain: MotorChain, now: float) -> np.ndarray:
        """Return the time (n,), s, by which samples may be newer than their stamps.

        After a loss, replies may count for older requests than they answer, and the adapter seem slower than it is.
        """
        lost = int(chain.lost.sum())
        if lost != self._lost:
            self._lost, self._lost_s = lost, now
        return now - chain.stamp_s if now - self._lost_s < _LOSS_S else chain.feedback.doubt_s

    def _note_action(self) -> None:
        """Write a leader's target for its follower, or a coupled follower's target, into the record."""
        record, lead, coupling = self._record, self._controller.lead, self._controller.coupling
        if lead is not None:
            lead.note(record)
        elif coupling.number or self._coupled:
            self._coupled = bool(coupling.number)
            record["coupled_to"] = coupling.number
            if coupling.number:  # else `action` may already be a caller's target
                slots = self._slots
                record["action"][slots], record["action_dq"][slots] = coupling.target, coupling.velocity
                record["action_stamp_s"] = record["stamp_s"]

    def _note_seldom(self, stops: GripperStops | None, trouble: Trouble | None, message: str) -> None:
        """Write rarely changing values into the record if any has changed: encoding texts is slow."""
        seldom = (stops, trouble, message)
        if seldom != self._seldom:
            self._record["gripper_stops_rad"] = np.nan if stops is None else (stops.closed_rad, stops.open_rad)
            self._record["trouble"] = (trouble or "").encode()
            self._record["message"] = message.encode()[:400]
            self._seldom = seldom

    @property
    def owned(self) -> bool:
        """Whether this process still owns the arm; False once another loop has taken over."""
        return bool(self._states.peek(*OWNER) == self._owner)

    def close(self, remove: bool) -> None:
        """Close both blocks. remove: whether to remove the state block; False if a stand-by continues to use it."""
        if self._controller.lead is not None:
            self._controller.lead.close()
        self._controller.coupling.close()
        self._states.close(remove)
        if remove:
            forget_about(self._key)
        self._commands.close()


def _packed(handle: HandleState) -> tuple[float, ...]:
    """Return the handle's values in the order of `EACH_TICK`."""
    return handle.trigger, *handle.buttons, handle.stamp_s, *handle.presses
