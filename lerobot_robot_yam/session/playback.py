"""Playback: streams targets to arms along a trajectory. Used by YamArm, yam-float and the page's replay."""

from collections.abc import Sequence

import numpy as np

from lerobot_robot_yam.control.safety.progress_monitor import far_behind
from lerobot_robot_yam.errors import LifeCycleError
from lerobot_robot_yam.session.arm_client import ArmClient
from lerobot_robot_yam.session.trajectory import Trajectory, soft_way, soft_way_s
from lerobot_robot_yam.state.modes import Mode
from lerobot_robot_yam.state.records import Limited

# peak speed of the approach to the first pose, rad/s: slow, because a hand may still be near the arm
APPROACH_RAD_S = 0.5
_SPEED_SHARE = 0.9  # fraction of the speed limits that a replay uses, so that the set-point does not lag
_REACHED = 1e-3  # distance from the goal at which a set-point counts as arrived, rad or strokes
_LEAST_S = 0.2  # minimum duration of the approach, s


class Playback:
    """Motion along a trajectory that starts at the current pose of the arms.

    Args:
        clients: clients of the arms; the arms have to hold.
        trajectory: trajectory with one column for each motor of these arms.
    """

    def __init__(self, clients: Sequence[ArmClient], trajectory: Trajectory):
        self._clients, self.trajectory = clients, trajectory
        self._began_s: float | None = None
        self.elapsed_s = 0.0
        ends = np.cumsum([client.hardware.n for client in clients]).tolist()
        self._columns = [slice(end - client.hardware.n, end) for client, end in zip(clients, ends, strict=True)]

    def step(self, now: float) -> bool:
        """Write the targets for time `now`. Return whether the motion has ended. Call `step` at 30 Hz or faster.

        Raises:
            LifeCycleError: an arm no longer accepts targets; the message names the arm.
            YamError: an arm is in fault or silent, see `ArmClient.observe`.
        """
        for client in self._clients:
            state = client.newest()
            if state.mode not in (Mode.HOLD, Mode.TRACK) or Limited.PEER in state.limited:
                why = "holds for the other one" if Limited.PEER in state.limited else f"is in mode {state.mode.name}"
                raise LifeCycleError(f"{client.config.name}: pose not reached, the arm {why.lower()}")
        self._began_s = now if self._began_s is None else self._began_s
        self.elapsed_s = now - self._began_s
        row = self.trajectory.at(self.elapsed_s)
        for client, columns in zip(self._clients, self._columns, strict=True):
            joints = client.hardware.joints
            q = row[columns]
            client.write_target(q[:joints], float(q[-1]) if client.hardware.has_gripper else None)
        return self.elapsed_s >= self.trajectory.seconds

    def late(self) -> str:
        """Return the names of an arm and its joint that is not at the trajectory's end; empty if all joints are."""
        for client, columns in zip(self._clients, self._columns, strict=True):
            hw, state = client.hardware, client.observe()
            goal = self.trajectory.positions[-1, columns]
            late = np.abs(np.array(state.setpoints) - np.minimum(np.maximum(goal, hw.lower), hw.upper)) >= _REACHED
            j = slice(hw.joints)
            late[j] |= far_behind(state.q - goal[j], client.kp, hw.torque_limit_nm[j])
            if late.any():
                return f"{hw.name}: {hw.motors[int(late.argmax())].name}"
        return ""


def ready(clients: Sequence[ArmClient]) -> np.ndarray:
    """Make floating arms hold. Return the set-points (n,) of all motors.

    Raises:
        YamError: an arm is in fault or silent.
    """
    for client in clients:
        if client.observe().mode is Mode.FLOAT:
            client.hold()
    return np.concatenate([client.observe().setpoints for client in clients])


def replay(clients: Sequence[ArmClient], trajectory: Trajectory) -> Playback:
    """Create the playback of a trajectory: soft approach to the first pose, then the trajectory, slowed to the limits.

    Raises:
        ActionError: the trajectory does not fit these arms, see `Trajectory.check`; nothing moves.
        YamError: an arm is in fault or silent.
    """
    trajectory.check([client.hardware for client in clients])
    limit = np.concatenate([client.hardware.speed_limit for client in clients])
    start = ready(clients)
    first = trajectory.positions[0]
    approach = soft_way(start, first, approach_s(first - start, np.minimum(limit, APPROACH_RAD_S)))
    return Playback(clients, approach.then(trajectory.slowed(_SPEED_SHARE * limit)))


def approach_s(way: np.ndarray, speed: np.ndarray) -> float:
    """Return the duration, s, of a soft path over distances `way` (n,) at peak speed `speed` (n,); at least 0.2 s."""
    return max(soft_way_s(way, speed), _LEAST_S)
