"""The operations of a rig that play a person's hands: they move arms, squeeze triggers and press buttons."""

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any

import numpy as np

from lerobot_robot_yam.errors import ConfigError

_PATH_POINTS = 30


def soft_path(start: Sequence[float], end: Sequence[float], seconds: float) -> tuple[np.ndarray, np.ndarray]:
    """Times (k,) s and joints (k, n) of a straight way with half-cosine speed, from 0 to `seconds`.

    Raises:
        ConfigError: start and end do not fit, or seconds are not above zero.
    """
    first, last = np.asarray(start, float), np.asarray(end, float)
    if first.shape != last.shape or not np.isfinite(last).all():
        raise ConfigError(f"an arm of {len(first)} joints cannot be brought to {end!r}")
    if not 0.0 < seconds < math.inf:
        raise ConfigError(f"a way takes a time above zero, not {seconds!r}")
    share = np.linspace(0.0, 1.0, _PATH_POINTS + 1)
    return share * seconds, first + (0.5 - 0.5 * np.cos(np.pi * share))[:, None] * (last - first)


class HandOperations(ABC):
    """Part of `RigOperations`."""

    @abstractmethod
    def request(self, op: str, **arguments: Any) -> dict[str, Any]:
        """Ask the rig; returns its answer."""

    def state(self, bodies: bool = False, brief: bool = False) -> dict[str, Any]:
        """The true state of the world; `brief` leaves out sites, and of motors all but `enabled`: it takes less time.

        Returns:
            sim_s, monotonic_s; arms[channel]: q and dq (n,), opening 0 … 1 or None, trigger, buttons, held,
            resists (the hand has let go of an arm that worked against it), clients,
            motors[name]: {id, enabled, fault, torque_nm, motor_rad, flash_writes},
            second_motors (of fault "second_arm") alike, tcp_site and grasp_site: {pos (3,), mat (9,)};
            props[name] and furniture[name]: {pos, quat};
            joints[name], of furniture: m or rad; with `bodies`, bodies[name]: position (3,).
        """
        return self.request("state", bodies=bodies, brief=brief)

    def trigger(self, channel: str, value: float) -> None:
        """Squeeze a handle's trigger: 0 released … 1."""
        self.request("trigger", channel=channel, value=value)

    def buttons(self, channel: str, sync: bool = False, record: bool = False) -> None:
        """Hold a handle's two buttons down, or not."""
        self.request("buttons", channel=channel, value=[sync, record])

    def press(self, channel: str, button: str, seconds: float = 0.1) -> None:
        """Press a handle's button, "sync" (the top one) or "record", and let it go after so long (0.005 … 60 s).

        Each edge of a button is an event "button" with channel, button and down.
        """
        self.request("press", channel=channel, button=button, seconds=seconds)

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
        """Grip an arm and pull it with limited force, from where it is, along q (k, n) at times (k,) s from now.

        Then hold it there. Joints that are elsewhere than q join it at 2 rad/s. A leader is held firmly at each joint
        (200 Nm/rad, at most 12 Nm). A follower, and a leader for which one of the next three is given, is held softly:
        the hand is a mass that is fixed to the tool, on a damped spring to where the tool would be at q, at most 60 N.

        Args:
            stiffness_n_m, mass_kg, damping_ratio: of a soft hand; 0 … 5000 (1000), 0.05 … 5 (0.5), 0 … 2 (0.7).
            gives_way: as a person would, let go after 0.4 s of an energised arm that works against the hand with
                2.5 Nm at a joint, or 25 N at a soft hand; event "hand_gave_way".
            then_release: let go at the end of the path. The event "hand_arrived" tells of the end.
        """
        softness = {"stiffness_n_m": stiffness_n_m, "mass_kg": mass_kg, "damping_ratio": damping_ratio}
        ways = {"gives_way": gives_way, "then_release": then_release}
        self.request("hand", channel=channel, times=times, q=q, trigger=trigger, **softness, **ways)

    def lift(self, channel: str, q: Sequence[float], seconds: float = 1.5, **options: Any) -> None:
        """Take an arm by hand to q (n,), a straight way in the joints with a soft start and end, and hold it there.

        Event "hand_arrived" at the end. `options`: as of `hand`, such as trigger or mass_kg.
        """
        start = self.state()["arms"].get(channel, {}).get("q", q)  # an unknown channel is refused below
        times, path = soft_path(start, q, seconds)
        self.hand(channel, times.tolist(), path.tolist(), **options)

    def bring_home(
        self, channel: str, home: Sequence[float] | None = None, seconds: float = 1.5, **options: Any
    ) -> None:
        """The same to `home` (by default all joints at zero), and let go there."""
        if home is None:
            home = [0.0] * len(self.state()["arms"].get(channel, {}).get("q", ()))
        self.lift(channel, home, seconds, **{"then_release": True, **options})

    def release(self, channel: str) -> None:
        """Let an arm go."""
        self.request("hand", channel=channel, release=True)
