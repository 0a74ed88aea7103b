"""Operations of a person's hands: they move arms, squeeze triggers and press buttons."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.rig.simulation.grips import Softness
from lerobot_robot_yam.rig.simulation.operation import Operations, number, operation

_PATH_POINTS = 30
_PRESS_S = (0.005, 60.0)  # shortest and longest press, s; the rig looks for the end of a press each 5 ms


class HandOperations(Operations):
    """Operations of a person's hands."""

    @operation
    def trigger(self, channel: str, value: float) -> None:
        """Squeeze a handle's trigger: 0 released … 1."""
        handle = self._handle_of(channel)
        handle.trigger, handle.trigger_rate = number(value, 0.0, 1.0), 0.0

    @operation
    def buttons(self, channel: str, sync: bool = False, record: bool = False) -> None:
        """Hold a handle's two buttons down, or not."""
        self._handle_of(channel)
        self.device.presses.hold(self._channel_of(channel), (sync, record))

    @operation
    def press(self, channel: str, button: str, seconds: float = 0.1) -> None:
        """Press a handle's button, "sync" (the top one) or "record", for 0.005 … 60 s.

        Each edge of a button is an event "button" with channel, button and down.
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
        """Grip an arm and pull it with limited force, from its pose, along q (k, n) at times (k,) s from now.

        Then hold the arm there. Joints that are elsewhere than q go to q at 2 rad/s. A leader is held firmly at each
        joint (200 Nm/rad, at most 12 Nm). A follower, and a leader with one of the next three arguments, is held
        softly: the hand is a mass fixed to the tool, on a damped spring to the tool's place at q, at most 60 N.

        Args:
            stiffness_n_m, mass_kg, damping_ratio: range (default): 0 … 5000 (1000), 0.05 … 5 (0.5), 0 … 2 (0.7).
            gives_way: whether, as a person would, to let go after 0.4 s of an energised arm that works against the hand
                with 2.5 Nm at a joint, or 25 N at a soft hand; event "hand_gave_way".
            then_release: whether to let go at the end of the path. The event "hand_arrived" marks the end.
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
        """Move an arm by hand to q (n,), straight in joint space with a soft start and end, and hold it there.

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
        """Lift an arm to `home` (by default all joints at zero), and let go there."""
        home = [0.0] * len(self.joints(channel)["q"]) if home is None else home
        self.lift(channel, home, seconds, **{"then_release": True, **options})

    @operation
    def joints(self, channel: str) -> dict[str, Any]:
        """Read the joints of one arm, under the key q: (n,) rad."""
        world = self.device.world
        return {"q": [world.qpos[address] for address in world.joint_addresses(self._channel_of(channel).name)]}
