"""Caller of the soak: a teleoperation loop over the shipped LeRobot classes that checks the returned values."""

import logging
import math
import queue
import time
from collections import Counter
from collections.abc import Callable
from typing import Any

from lerobot_robot_yam.errors import YamError
from soak.devices import Device
from soak.injector import Injector
from soak.operator import Operator

logger = logging.getLogger("soak")

_RATE_HZ = 45.0
_FAR_TICKS = 8
_OUTSIDE_RAD = 0.2  # a held pose, which is returned as sent, may be this far outside the limits
_NAMES = ("follower", "leader", "joint_", "gripper")  # each error text must contain one of these


class Teleoperation:
    """Drives robot and leader while faults are injected.

    Args:
        robot, leader: the devices.
        operator: recovers devices after errors.
        injector: puts the caller's own faults into `for_caller`.
        violation: callback that receives invariant, channel or device, and description.
    """

    def __init__(
        self,
        robot: Device,
        leader: Device,
        operator: Operator,
        injector: Injector,
        violation: Callable[[str, str, str], None],
    ):
        self._robot, self._leader, self._operator, self._injector = robot, leader, operator, injector
        self._violation = violation
        self._far: tuple[str, float, int] | None = None
        self.counts: Counter[str] = operator.counts
        self.errors: Counter[str] = Counter()
        self.oldest_state_s = 0.0

    def connect(self) -> None:
        """Energise both devices."""
        for device in (self._robot, self._leader):
            self._operator.connect(device)

    def run(self, until_s: float, on_tick: Callable[[], None]) -> None:
        """Teleoperate until the monotonic time `until_s`."""
        next_s = time.monotonic()
        while time.monotonic() < until_s:
            self._misbehave()
            self._tick()
            on_tick()
            next_s = max(next_s + 1.0 / _RATE_HZ, time.monotonic())
            time.sleep(max(0.0, next_s - time.monotonic()))

    def disconnect(self) -> None:
        """Land both devices, and check that no motor is energised afterwards."""
        for device in (self._leader, self._robot):
            self._operator.disconnect(device)
            self._operator.check_limp(device)

    def _tick(self) -> None:
        self.counts["ticks"] += 1
        observation = self._call(self._robot, self._observe)
        action = None if observation is None else self._call(self._leader, self._ask_leader)
        if action is None:
            return
        if self._far is not None:
            key, value, left = self._far
            action = action | {key: value}
            self._far = (key, value, left - 1) if left > 1 else None
        sent = self._call(self._robot, lambda: self._robot.device.send_action(action))
        if sent is not None:
            self._check_sent(sent)
            self.counts["actions sent"] += 1
            self._operator.guide()

    def _call(self, device: Device, work: Callable[[], Any]) -> Any:
        """Return the result; None if the call failed, after the operator has recovered the device."""
        try:
            return work()
        except YamError as error:
            text = str(error)
            self.errors[type(error).__name__] += 1
            logger.info("%s: %s: %s", device.name, type(error).__name__, text)
            if not any(name in text for name in _NAMES):
                self._violation("errors name the part", device.name, text)
            self._operator.see_to(device)
        except Exception as error:
            self._violation("errors are YamErrors", device.name, f"{type(error).__name__}: {error}")
            self._operator.see_to(device)
        return None

    def _observe(self) -> dict[str, Any]:
        begin = time.monotonic()
        observation = self._robot.device.get_observation()
        self._check_age(self._robot, begin, time.monotonic())
        for key, value in observation.items():
            if isinstance(value, float) and not math.isfinite(value):
                self._violation("observations are finite", self._robot.name, f"{key} is {value}")
        return observation

    def _ask_leader(self) -> dict[str, float]:
        begin = time.monotonic()
        action: dict[str, float] = self._leader.device.get_action()
        self._check_age(self._leader, begin, time.monotonic())
        return action

    def _check_age(self, device: Device, begin: float, now: float) -> None:
        age = now - min(device.stamps_s)
        self.oldest_state_s = max(self.oldest_state_s, age)
        limit = device.max_state_age_s
        if age > limit + now - begin:  # the call checked the age; the machine may have delayed the call since
            self._violation("no state older than its stated age", device.name, f"{age:.3f} s old, at most {limit} s")
        elif age > limit:
            self.counts["became old while the call was held up"] += 1

    def _check_sent(self, sent: dict[str, float]) -> None:
        for side in self._robot.device._arms.sides:
            hardware = side.hardware
            for motor, low, high in zip(side.motors, hardware.lower, hardware.upper, strict=True):
                value = sent[f"{motor}.pos"]
                if not low - _OUTSIDE_RAD <= value <= high + _OUTSIDE_RAD:
                    self._violation("targets are limited", self._robot.name, f"{motor} was sent {value}")

    def _misbehave(self) -> None:
        """Carry out the next scheduled fault of the caller, if any."""
        try:
            injection = self._injector.for_caller.get_nowait()
        except queue.Empty:
            return
        self._injector.began(injection)
        if injection.kind == "caller_stall":
            time.sleep(injection.seconds)
        else:
            keys = self._robot.device._arms.keys
            self._far = (keys[injection.number % len(keys)], float(injection.value), _FAR_TICKS)
