"""Monitor of one channel: silent, faulted or implausible motors, another driver, and frames that cannot be sent."""

import errno
import math
from dataclasses import dataclass

import numpy as np

from lerobot_robot_yam.damiao.chain import MotorChain
from lerobot_robot_yam.damiao.tables import Fault, fault_text
from lerobot_robot_yam.errors import BusError
from lerobot_robot_yam.state.faults import FAULT_TROUBLE, SILENT_S, Trouble

_MOTOR_MISSED = 10  # unanswered commands after which a motor is lost; time alone is no proof: machines may be suspended
_CHANNEL_MISSED = 5  # commands without a reply, for every motor, that may mean a lost channel
_WINDOW_S = 0.4  # counting window for stray frames, s; reports them within 0.5 s
_DUPLICATES = 5  # surplus replies per window, late ones excluded, that indicate a duplicate CAN id
_FOREIGN = 3  # foreign commands per window that indicate another driver
_LIES = "readings that no joint can have; check cable and plug, and that no second arm shares the channel"

_BUS_TROUBLE = {
    errno.ENODEV: Trouble.ADAPTER_GONE,
    errno.ENETDOWN: Trouble.LINK_DOWN,
    errno.ENOBUFS: Trouble.BUS_OFF,
}
_FULL_S = 0.05  # time after which a full transmit queue counts as stuck, s; after a late tick a queue empties sooner


@dataclass(frozen=True)
class Finding:
    """Result of a check. bad: (n,) bool, unreliable motors; trouble: fault of the channel or a motor, or None."""

    bad: np.ndarray
    trouble: Trouble | None = None
    message: str = ""


class ChannelMonitor:
    """Monitor of a chain's motors for silence, faults and implausible readings. Check once per tick."""

    def __init__(self, chain: MotorChain):
        self._chain = chain
        self._none = self._bad = np.zeros(len(chain), dtype=bool)
        self._well = Finding(self._none)
        self._faulty: np.ndarray = ~self._none
        self._told_s: np.ndarray = np.full(len(chain), math.nan)  # timestamp of the reply that first reported a fault
        self._stray = _StrayFrames(chain)

    def check(self, now: float) -> Finding:
        """Check every motor; the message of the finding names each unreliable motor and the reason."""
        chain = self._chain
        if chain.all_answered and chain.all_normal:  # the usual case
            self._bad = self._faulty = self._none
            trouble, message = self._stray.check(now)
            return self._well if trouble is None else Finding(self._none, trouble, message)
        missed, lies = chain.missed, chain.distrusted
        silent = (chain.silence_s(now) > SILENT_S) & (missed >= _MOTOR_MISSED)
        bad = silent | lies | self._confirmed(chain.fault != Fault.NORMAL)
        falling = (missed >= _CHANNEL_MISSED).all() and not silent.all() and not (bad & ~silent).any()
        if falling:  # wait until the other motors reply again or are silent for SILENT_S, too
            return Finding(self._bad)
        self._bad = bad
        if not bad.any():
            return Finding(bad, *self._stray.check(now))
        if silent.all():
            age = float((now - chain.stamp_s).min())
            return Finding(
                bad,
                Trouble.BUS_SILENT,
                f"no motor answers on {chain.channel} for {age:.2f} s: check motor power and the emergency stop, "
                f"the CAN cable, and the link (ip -details link show {chain.channel})",
            )
        reasons: dict[str, list[str]] = {}
        for index in np.flatnonzero(bad):
            motor = chain.motors[index]
            age = now - chain.stamp_s[index]
            why = f"silent for {age:.2f} s" if silent[index] else fault_text(int(chain.fault[index]))
            reasons.setdefault(_LIES if lies[index] else why, []).append(f"{motor.name} (id {motor.can_id})")
        message = "; ".join(f"{', '.join(names)}: {why}" for why, names in reasons.items())
        faulty = np.flatnonzero(bad & ~silent & ~lies)
        trouble = FAULT_TROUBLE.get(int(chain.fault[faulty[0]]), Trouble.OVERLOAD) if len(faulty) else None
        return Finding(bad, trouble or (Trouble.IMPLAUSIBLE if lies.any() else Trouble.MOTOR_SILENT), message)

    def _confirmed(self, faulty: np.ndarray) -> np.ndarray:
        """Return (n,) bool: motors with a fault in at least two replies, since a single reply may be garbled.

        For a motor that was already unreliable, e.g. silent, a single reply is sufficient.
        """
        stamp_s = self._chain.stamp_s
        first = faulty & ~self._faulty
        self._told_s = np.where(first, np.where(self._bad, math.nan, stamp_s), self._told_s)
        self._faulty = faulty
        confirmed: np.ndarray = faulty & (stamp_s != self._told_s)
        return confirmed


class _StrayFrames:
    """Counter of unexpected frames: surplus replies, and commands of another driver."""

    def __init__(self, chain: MotorChain):
        self._chain = chain
        self._since, self._lost = -math.inf, chain.lost
        self._note(0.0)

    def _note(self, now: float) -> None:
        chain = self._chain
        self._since, self._lost_before, self._lost = now, self._lost, chain.lost
        self._doubled, self._foreign = chain.duplicates, chain.foreign_commands

    def check(self, now: float) -> tuple[Trouble | None, str]:
        if now - self._since < _WINDOW_S:
            return None, ""
        chain = self._chain
        # A late reply counts as surplus: each lost reply explains one surplus reply, even if the reply was lost in the
        # previous window.
        beyond = chain.duplicates - self._doubled - (chain.lost - self._lost_before)
        doubled = np.flatnonzero(beyond >= _DUPLICATES)
        foreign = chain.foreign_commands - self._foreign
        self._note(now)
        if foreign >= _FOREIGN:
            return (  # checked first, since replies to foreign commands look like duplicates
                Trouble.FOREIGN_DRIVER,
                f"another driver commands the motors on {chain.channel} ({foreign} frames in {_WINDOW_S} s); stop it",
            )
        if len(doubled):
            names = ", ".join(f"{chain.motors[i].name} (id {chain.motors[i].can_id})" for i in doubled)
            return Trouble.DUPLICATE_ID, f"more than one answer from {names}: two motors share an id"
        return None, ""


class BusLoss:
    """Send state of a channel. `lost`: whether no frame reaches the motors."""

    def __init__(self) -> None:
        self.lost = False
        self._full_since_s = math.inf

    def clear(self) -> None:
        """Record that the channel has accepted all frames of a tick."""
        self.lost, self._full_since_s = False, math.inf

    def note(self, error: BusError, now: float) -> Trouble | None:
        """Record a failed send. Return the fault once, as soon as the loss is certain; else None."""
        trouble = _BUS_TROUBLE.get(error.errno or 0, Trouble.ADAPTER_GONE)
        if trouble is Trouble.BUS_OFF:
            self._full_since_s = min(self._full_since_s, now)
            if now - self._full_since_s < _FULL_S:
                return None
        before, self.lost = self.lost, True
        return None if before else trouble
