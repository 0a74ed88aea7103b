"""Operations of a person's hands: moving arms, squeezing triggers and pressing buttons."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.rig.simulation.grips import Softness
from lerobot_robot_yam.rig.simulation.operation import Operations, number, operation, vector

_PATH_POINTS = 30
_DRIVE_S = 0.3  # time for which a hand's wish to drive is valid, s: a hand that is gone drives nothing
_READER_S = 1.0  # time after which a reader of that counts as gone, s: a busy recorder may miss several frames
_PRESS_S = (0.005, 60.0)  # minimum and maximum press, s; the rig checks for the end every 5 ms


class HandOperations(Operations):
    """Operations that simulate a person's hands."""

    @operation
    def trigger(self, channel: str, value: float) -> None:
        """Squeeze a handle's trigger: 0 released … 1 squeezed."""
        handle = self._handle_of(channel)
        handle.trigger, handle.trigger_rate = number(value, 0.0, 1.0), 0.0

    @operation
    def buttons(self, channel: str, sync: bool = False, record: bool = False) -> None:
        """Hold down or release each of a handle's two buttons."""
        self._handle_of(channel)
        self.device.presses.hold(self._channel_of(channel), (sync, record))

    @operation
    def press(self, channel: str, button: str, seconds: float = 0.1) -> None:
        """Press a handle's button, "sync" (the top button) or "record", for 0.005 … 60 s.

        Each edge of a button adds an event "button" with channel, button and down.
        """
        self._handle_of(channel)
        until_s = self.device.world.sim_s + number(seconds, *_PRESS_S)
        self.device.presses.press(self._channel_of(channel), button, until_s)

    @operation
    def hand(
        self,
        channel: str,
        times: Sequence[float],
        q: Sequence[Sequence[float]],
        trigger: float | Sequence[float] = 0.0,
        *,
        stiffness_n_m: float | None = None,
        mass_kg: float | None = None,
        damping_ratio: float | None = None,
        gives_way: bool = True,
        then_release: bool = False,
    ) -> None:
        """Grip an arm and pull it with limited force from its pose along q (k, n) at times (k,), s from now.

        Then hold the arm at the end. Joints away from the start of q move there at 2 rad/s. A leader is held firmly at
        each joint (200 Nm/rad, at most 12 Nm). A follower, or a leader with one of the next three arguments, is held
        softly: the hand is a mass fixed to the tool, on a damped spring to the tool pose at q, with at most 60 N.

        Args:
            stiffness_n_m, mass_kg, damping_ratio: range (default): 0 … 5000 (1000), 0.05 … 5 (0.5), 0 … 2 (0.7).
            gives_way: whether, like a person, to release an energised arm that for 0.4 s resists the hand with 2.5 Nm
                at a joint, or with 25 N at a soft hand; adds the event "hand_gave_way".
            then_release: whether to release the arm at the end of the path. The event "hand_arrived" marks the end.
        """
        hand = self.device.hands[self._channel_of(channel).name]
        given = {"stiffness_n_m": stiffness_n_m, "mass_kg": mass_kg, "damping_ratio": damping_ratio}
        asked = {name: value for name, value in given.items() if value is not None}
        softness = Softness(**asked).check() if asked else None
        hand.move(times, q, trigger, softness, gives_way, then_release)

    @operation
    def release(self, channel: str) -> None:
        self.device.hands[self._channel_of(channel).name].release()

    def lift(self, channel: str, q: Sequence[float], seconds: float = 1.5, **options: Any) -> None:
        """Move an arm by hand to q (n,), straight in joint space with a smooth start and end, and hold it there.

        The event "hand_arrived" marks the end. options: further arguments of `hand`, such as trigger or mass_kg.
        """
        first, last = np.array(self.joints(channel)["q"]), np.asarray(q, float)
        if first.shape != last.shape or not np.isfinite(last).all():
            raise ConfigError(f"an arm of {len(first)} joints cannot be brought to {q!r}")
        if not 0.0 < seconds < math.inf:
            raise ConfigError(f"a way takes a time above zero, not {seconds!r}")
        share = np.linspace(0.0, 1.0, _PATH_POINTS + 1)
        path = first + (0.5 - 0.5 * np.cos(np.pi * share))[:, None] * (last - first)
        self.hand(channel, (share * seconds).tolist(), path.tolist(), **options)

    def bring_home(
        self, channel: str, home: Sequence[float] | None = None, seconds: float = 1.5, **options: Any
    ) -> None:
        """Lift an arm to `home` (by default all joints at zero), and release it there."""
        home = [0.0] * len(self.joints(channel)["q"]) if home is None else home
        self.lift(channel, home, seconds, **{"then_release": True, **options})

    @operation
    def ask_drive(self, velocity: Sequence[float]) -> None:
        """Ask for a velocity of the base (3,), m/s, m/s, rad/s, in its own frame, as a hand on a gamepad does.

        It is valid for 0.3 s, and moves nothing by itself: a teleoperator reads it by `asked_drive`.
        """
        self.device.asked_drive = self.device.world.sim_s, vector(velocity, 3).tolist()

    @operation
    def asked_drive(self, reads: bool = False, episode: float | None = None) -> dict[str, Any]:
        """Read what a hand asks the base to do, under the key velocity: (3,), m/s, m/s, rad/s; zeros if nothing.

        reads: whether the caller drives the base so, for `drive_reader`. episode: that it records, with another number
        for each; 0 if it records none, None between two episodes.
        """
        now = self.device.world.sim_s
        if reads:
            self.device.drive_reader = now, None if episode is None else number(episode, 0.0)
        at_s, velocity = self.device.asked_drive
        return {"velocity": velocity if now - at_s <= _DRIVE_S else [0.0] * 3}

    @operation
    def drive_reader(self) -> dict[str, Any]:
        """Read whether somebody reads what hands ask the base to do, and the episode, see `asked_drive`."""
        at_s, episode = self.device.drive_reader
        return {"reads": self.device.world.sim_s - at_s <= _READER_S, "episode": episode}

    @operation
    def joints(self, channel: str) -> dict[str, Any]:
        """Read the joints of one arm, under the key q: (n,), rad."""
        world = self.device.world
        return {"q": [world.qpos[address] for address in world.joint_addresses(self._channel_of(channel).name)]}
