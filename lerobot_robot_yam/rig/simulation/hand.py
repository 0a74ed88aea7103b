"""A person's hands: pull arms along trajectories with limited force, squeeze triggers and press buttons.

The arm's own motors act with or against the hand. Like a person, a hand releases an arm that works against it, for
example an arm that lands.
"""

import bisect
import math
from collections.abc import Callable, Sequence

import numpy as np

from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.rig.bus.channel import Channel
from lerobot_robot_yam.rig.devices.simulated_handle import SimHandle
from lerobot_robot_yam.rig.simulation.grips import FirmGrip, Grip, SoftGrip, Softness
from lerobot_robot_yam.rig.world.world import World

_BUTTONS = ("sync", "record")  # top and second button of a handle
_PERIOD_S = 0.002  # interval between interpolations of the target, s
# Speed of a joint towards a path that begins elsewhere: above the planner's (1.2), below a fall's (3). A path begins
# elsewhere after a slip of the simulated clock, or if a floating arm has moved since the path was planned.
_JOIN_RAD_S = 2.0
_RESIST_S = 0.4  # minimum duration of resistance; starts and stops cause shorter peaks


class Hand:
    """A hand on the arm of a channel, and on the channel's handle encoder if there is one.

    Attributes:
        due_s: simulated time of the next `advance` while `gripping`.

    Args:
        firm: the default grip on a leader; None on a follower.
        soft: the soft grip.
        told: callback that receives an event kind when the path is completed or the hand gives way.
    """

    def __init__(
        self,
        world: World,
        channel: str,
        handle: SimHandle | None,
        firm: FirmGrip | None,
        soft: SoftGrip,
        told: Callable[[str], None],
    ):
        self._world, self._handle, self._told = world, handle, told
        self._firm, self._soft = firm, soft
        self._grip: Grip = soft if firm is None else firm
        count = world.profiles[channel][0].joint_count
        self._count = count
        self._addresses = world.joint_addresses(channel)
        self._start_s = 0.0
        # Lists, because `advance` reads single numbers. Each row: the joints, then the trigger.
        self._times: list[float] = [0.0]
        self._path: list[list[float]] = [[0.0] * (count + 1)]
        self._rates: list[list[float]] = self._path
        self._targets = self._path[0][:count]  # joints at `_advanced_s`
        self._advanced_s = self.due_s = 0.0
        self.gripping = False
        self.resisted = False  # whether the arm resisted; the hand grips again only once the arm was limp
        self._easy_s = 0.0  # last time without resistance
        self._gives_way = True
        self._then_release = self._arrived = False

    def move(
        self,
        times_s: Sequence[float],
        q_rad: Sequence[Sequence[float]],
        trigger: float | Sequence[float],
        softness: Softness | None = None,
        gives_way: bool = True,
        then_release: bool = False,
    ) -> None:
        """Grip, and pull from the hand's position along q_rad (k, n) at times_s (k,) from now; then hold the end.

        A new grip starts at the arm's pose. Joints away from q_rad move there at `_JOIN_RAD_S`.

        Args:
            trigger: (k,) or one number, 0 released … 1 squeezed.
            softness: None for a firm grip on a leader, and for the default softness on a follower.
            gives_way: whether to release an arm that works against the hand.
            then_release: whether to release the arm at the end of the path.

        Raises:
            ConfigError: shapes do not match, times do not increase, or a value is not finite.
        """
        times, joints = np.asarray(times_s, float), np.asarray(q_rad, float)
        count = self._count
        squeeze = np.broadcast_to(np.asarray(trigger, float), times.shape)
        if times.ndim != 1 or len(times) < 1 or joints.shape != (len(times), count):
            raise ConfigError(f"a hand needs times (k,) and joints (k, {count}), not {times.shape} and {joints.shape}")
        path = np.column_stack([joints, squeeze])
        arm = [self._world.qpos[address] for address in self._addresses]
        if times[0] > 0.0:
            here = [*(self._targets if self.gripping else arm), path[0, -1]]
            times, path = np.insert(times, 0, 0.0), np.insert(path, 0, here, axis=0)
        if (np.diff(times) <= 0).any() or not np.isfinite(times).all() or not np.isfinite(path).all():
            raise ConfigError("a hand needs increasing times and finite values")
        rates = np.zeros_like(path)
        if len(times) > 1:
            rates[:-1] = np.diff(path, axis=0) / np.diff(times)[:, None]
        self._times, self._path, self._rates = times.tolist(), path.tolist(), rates.tolist()
        self._start_s = self.due_s = self._world.sim_s
        self._gives_way, self._then_release, self._arrived = gives_way, then_release, False
        if not self.gripping:
            self._easy_s, self._advanced_s = self._start_s, self._start_s - _PERIOD_S
            self._targets = arm
        self.gripping = not self.resisted
        if self.gripping:
            grip = self._soft if self._firm is None or softness is not None else self._firm
            if grip is not self._grip:
                self._grip.let_go()
            self._grip = grip
            grip.take_hold(softness)

    @property
    def soft(self) -> bool:
        """Whether the hand uses the soft grip, which acts in each step."""
        return self.gripping and self._grip is self._soft

    @property
    def force_n(self) -> np.ndarray:
        """Force (3,), N, of a soft hand on the tool, without the hand's weight; zeros for any other hand."""
        return self._soft.force_n() if self.soft else np.zeros(3)

    def step(self) -> None:
        self._grip.step()

    def release(self) -> None:
        """Release the arm and the trigger."""
        self.gripping = False
        self._grip.let_go()
        if self._handle is not None:
            self._handle.trigger = self._handle.trigger_rate = 0.0

    def advance(self, energised: bool) -> None:
        """Follow the trajectory; must be called when due, at least every few milliseconds of simulated time.

        energised: False for a limp arm, which is heavy but does not resist.
        """
        now = self._world.sim_s
        self.due_s = now + _PERIOD_S
        if not energised or not self._gives_way or not self._grip.strained():
            self._easy_s = now
        elif now - self._easy_s > _RESIST_S:
            self.resisted = True
            self.release()
            self._told("hand_gave_way")
            return
        t = now - self._start_s
        index = bisect.bisect_right(self._times, t) - 1
        row = max(index, 0)
        ahead = t - self._times[row] if index >= 0 else 0.0
        rates = self._rates[row].copy()
        targets = [start + rate * ahead for start, rate in zip(self._path[row], rates, strict=True)]
        elapsed, self._advanced_s = now - self._advanced_s, now
        joined = True
        for joint, here in enumerate(self._targets):
            way = targets[joint] - here
            if abs(way) > _JOIN_RAD_S * elapsed and abs(way) > (speed := max(_JOIN_RAD_S, abs(rates[joint]))) * elapsed:
                rates[joint] = math.copysign(speed, way)
                targets[joint] = here + rates[joint] * elapsed
                joined = False
        self._targets = targets[: self._count]
        self._grip.aim(self._targets, rates[: self._count])
        if self._handle is not None:
            self._handle.trigger = min(max(targets[-1], 0.0), 1.0)
            self._handle.trigger_rate = rates[-1]
        if joined and t >= self._times[-1] and not self._arrived:
            self._arrived = True
            if self._then_release:
                self.release()
            self._told("hand_arrived")


class ButtonPresses:
    """Presses of the handles' buttons.

    log: callback that receives, at each edge, the channel, the button, and whether the button is down.
    """

    def __init__(self, log: Callable[[str, str, bool], None]):
        self._log = log
        self._ends: dict[tuple[str, int], tuple[Channel, float]] = {}  # (channel, button) → simulated end time

    def press(self, channel: Channel, button: str, until_sim_s: float) -> None:
        """Hold a button down until a simulated time; a later call replaces the end of an earlier one.

        Raises:
            ConfigError: there is no such button.
        """
        if button not in _BUTTONS:
            raise ConfigError(f"a handle has the buttons {', '.join(_BUTTONS)}, not {button!r}")
        index = _BUTTONS.index(button)
        self._ends[channel.name, index] = channel, until_sim_s
        self._move(channel, index, True)

    def hold(self, channel: Channel, down: tuple[bool, bool]) -> None:
        """Hold down or release each of the two buttons from now on."""
        for index, one in enumerate(down):
            self._ends.pop((channel.name, index), None)
            self._move(channel, index, one)

    def advance(self, sim_s: float) -> None:
        """Release the buttons whose end time has passed."""
        for key, (channel, end_s) in list(self._ends.items()):
            if sim_s >= end_s:
                del self._ends[key]
                self._move(channel, key[1], False)

    def _move(self, channel: Channel, index: int, down: bool) -> None:
        handle = channel.handle
        assert handle is not None  # checked by the caller
        if handle.buttons[index] is not down:
            first, second = handle.buttons
            handle.buttons = (down, second) if index == 0 else (first, down)
            self._log(channel.name, _BUTTONS[index], down)
