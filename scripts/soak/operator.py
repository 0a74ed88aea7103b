"""Operator of the soak: acts like a person when teleoperation breaks. Re-arms where the policy says so; otherwise
disconnects, which lands the arms, and connects again. Also moves the leaders by hand.
"""

import logging
import random
import time
from collections import Counter
from collections.abc import Callable

from lerobot_robot_yam.errors import YamError
from lerobot_robot_yam.rig.control import RigControl
from lerobot_robot_yam.state.emergency_stop import EmergencyStop
from soak.devices import Device
from soak.injected_faults import LEADERS
from soak.injector import Injector
from soak.schedule import BACK_S, hand_path, lift_and_return

logger = logging.getLogger("soak")

PATIENCE_S = 1.5  # a control process that is silent for longer is ended by reconnecting
_HAND_S = 40.0
_LIFTED_S, _HOME_S = (6.0, 20.0), (0.2, 5.0)  # some stays at home are too short to release the leader or to arrive
_ATTEMPTS = 3
_REST_RAD_S = 1.0
_SETTLE_S = 0.6  # the motors' watchdog plus a margin
_LATE_LANDING_S = 15.0  # time-out for a landing that outlasts `disconnect`, s; even a fully extended arm lands faster


class Operator:
    """Connects, recovers and disconnects the devices, and moves the leaders.

    Args:
        rig: a connection that no other thread uses.
        injector: suspends faults while a device is connected or re-armed.
        seed: seed of the hand paths.
        violation: callback that receives invariant, channel or device, and description.
        coupled: whether lifting a leader engages it. If so, each hand path also brings the leaders home again.
    """

    def __init__(
        self,
        rig: RigControl,
        injector: Injector,
        seed: int,
        violation: Callable[[str, str, str], None],
        coupled: bool = False,
    ):
        self._rig, self._injector, self._violation = rig, injector, violation
        self._coupled = coupled
        self._chance = random.Random(f"{seed} operator")
        self._lands_late = False  # whether an arm lands only after `disconnect` has returned
        self._guided_until_s = 0.0  # end of the present hand paths
        self._used: set[str] = set()  # devices that have been connected before
        self.counts: Counter[str] = Counter()

    def see_to(self, device: Device) -> None:
        """Recover a device that has raised an error. The hands first release the leaders."""
        begin = time.monotonic()
        if device.channels == LEADERS or self._coupled:
            self.let_go()
        remedy = device.remedy()
        while remedy == "wait" and time.monotonic() - begin < PATIENCE_S:
            time.sleep(0.05)  # the stand-by ends and replaces a hung control process
            remedy = device.remedy()
        if remedy == "re-arm":
            with self._injector.quiet():
                self._let_swing(device)
                remedy = device.remedy()
                if remedy == "re-arm" and self._rearm(device):
                    return
        while remedy == "nothing" and time.monotonic() - begin < PATIENCE_S:
            if self._works(device):
                self.counts["recovered by itself"] += 1
                return
            time.sleep(0.05)
        self.disconnect(device)
        self.connect(device)

    def _let_swing(self, device: Device) -> None:
        """Wait until joints without torque are at rest, as a person would: wrist joints fall at 11 rad/s."""
        deadline = time.monotonic() + PATIENCE_S
        while time.monotonic() < deadline:
            arms = self._rig.state()["arms"]
            if all(abs(dq) < _REST_RAD_S for channel in device.channels for dq in arms[channel]["dq"]):
                return
            time.sleep(0.05)

    def _rearm(self, device: Device) -> bool:
        try:
            device.rearm()
        except YamError as error:
            self._violation("each recovery succeeds", device.name, f"re-arm: {error}")
            return False
        if not self._works(device):
            return False
        self.counts["re-armed"] += 1
        return True

    def _works(self, device: Device) -> bool:
        try:
            device.observe()
        except YamError as error:
            logger.info("%s does not work yet: %s", device.name, error)
            return False
        return True

    def disconnect(self, device: Device) -> None:
        """Disconnect, which lands the arms; faults may occur meanwhile."""
        if device.channels == LEADERS:
            self.let_go()
        logger.info("%s: disconnecting", device.name)
        begin = time.monotonic()
        try:
            device.device.disconnect()
        except Exception as error:
            self._violation("each recovery succeeds", device.name, f"disconnect: {type(error).__name__}: {error}")
        self._lands_late = EmergencyStop().latched  # the control loop lands the arm when the stop is released
        self.counts["disconnected"] += 1
        logger.info("%s: disconnected in %.1f s", device.name, time.monotonic() - begin)

    def connect(self, device: Device) -> None:
        """Connect without faults; the first attempt must succeed."""
        with self._injector.quiet():
            if device.name in self._used:
                self.check_limp(device)
            self._used.add(device.name)
            begin = time.monotonic()
            for attempt in range(_ATTEMPTS):
                try:
                    device.device.connect()
                    break
                except Exception as error:
                    self._violation("each recovery succeeds", device.name, f"connect: {type(error).__name__}: {error}")
                    if attempt == _ATTEMPTS - 1:
                        raise
                    time.sleep(1.0)
            logger.info("%s: connected in %.1f s", device.name, time.monotonic() - begin)
        self.counts["connected"] += 1

    def check_limp(self, device: Device) -> None:
        """Check that no motor is energised after disconnecting, or soon after an emergency stop is released."""
        deadline = time.monotonic() + _LATE_LANDING_S
        time.sleep(_SETTLE_S)  # motors that could not be reached disable themselves
        while self._lands_late and self._energised(device) and time.monotonic() < deadline:
            time.sleep(_SETTLE_S)
        if self._lands_late:
            time.sleep(_SETTLE_S)  # the process that has landed the arm disables it
        for channel, energised in self._energised(device).items():
            self._violation("nothing energised afterwards", channel, ", ".join(energised))

    def _energised(self, device: Device) -> dict[str, list[str]]:
        """Return the enabled motors of each channel that has any."""
        arms = self._rig.state()["arms"]
        on = {c: [name for name, motor in arms[c]["motors"].items() if motor["enabled"]] for c in device.channels}
        return {channel: names for channel, names in on.items() if names}

    def guide(self) -> None:
        """Start new hand paths for the leaders when the present ones have ended."""
        if time.monotonic() < self._guided_until_s:
            return
        arms = self._rig.state()["arms"]
        lasts_s = _HAND_S - 1.0
        if self._coupled:
            lifted_s, home_s = self._chance.uniform(*_LIFTED_S), self._chance.uniform(*_HOME_S)
            lasts_s = lifted_s + BACK_S + home_s
        for channel in LEADERS:
            q = arms[channel]["q"]
            if arms[channel]["resists"]:
                self.counts["a leader had resisted its hand"] += 1
            if self._coupled:  # a person who feels a force does not release the leader
                self._rig.hand(channel, *lift_and_return(self._chance, q, lifted_s, home_s), gives_way=False)
            else:
                self._rig.hand(channel, *hand_path(self._chance, q, _HAND_S))
        self.counts["hands took the leaders"] += 1
        self._guided_until_s = time.monotonic() + lasts_s

    def let_go(self) -> None:
        """Release both leaders."""
        for channel in LEADERS:
            self._rig.release(channel)
        self._guided_until_s = 0.0
