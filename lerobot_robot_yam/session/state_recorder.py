"""Recorder of the states that the control loops publish."""

import io
import threading
from array import array
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

import numpy as np

from lerobot_robot_yam.errors import ActionError, ConfigError, YamError
from lerobot_robot_yam.session.arm_client import ArmClient
from lerobot_robot_yam.session.trajectory import Trajectory, columns_of
from lerobot_robot_yam.state.arm_state import ArmState
from lerobot_robot_yam.system.paths import write_whole

_POLL_S = 0.001  # polling interval of the states, s: a quarter of a tick


class StateRecorder:
    """Recorder of each published state of some arms. Call `poll` often: a state between two polls is lost."""

    def __init__(self, clients: Sequence[ArmClient]):
        self._clients = clients
        self._rows = [array("d") for _ in clients]
        self._stamps_s = [0.0 for _ in clients]

    def poll(self) -> None:
        """Append the newest states. Raises LifeCycleError: an arm is not connected."""
        for index, client in enumerate(self._clients):
            state = client.published()
            if state.stamp_s > self._stamps_s[index]:
                self._stamps_s[index] = state.stamp_s
                self._rows[index].extend(_row(state))

    def states(self) -> list[dict[str, np.ndarray]]:
        """Return the states of each arm, k rows. The n motors are the joints, then the gripper if it has a motor.

        Returns:
            Per arm, name -> array: stamp_s (k,) monotonic time; q (k, n) rad and dq (k, n) rad/s, the gripper 0 … 1 and
            1/s; tau_nm (k, n), the gripper's at its motor; temp_mos_c, temp_rotor_c (k, n).
        """
        return [_unpacked(rows, client.hardware.n) for rows, client in zip(self._rows, self._clients, strict=True)]

    def trajectory(self) -> Trajectory:
        """Return the positions of all arms, interpolated at the timestamps of the first arm's states.

        Raises:
            ActionError: there are fewer than two states.
        """
        states = self.states()
        if min(len(arm["stamp_s"]) for arm in states) < 2:
            raise ActionError("the recording is too short: it has fewer than two states of an arm")
        times = states[0]["stamp_s"]
        columns = [np.interp(times, arm["stamp_s"], column) for arm in states for column in arm["q"].T]
        names = columns_of([client.hardware for client in self._clients])
        return Trajectory(times, np.stack(columns, axis=1), names, "recording")

    def save(self, path: Path) -> None:
        """Write the arrays of `states` to an .npz file. From the second arm on, array names begin with the arm's name.

        Raises:
            ConfigError: the file cannot be written.
        """
        content: dict[str, np.ndarray] = {}
        for index, (client, states) in enumerate(zip(self._clients, self.states(), strict=True)):
            prefix = f"{client.config.name}_" if index else ""
            content |= {f"{prefix}{name}": values for name, values in states.items()}
            content[f"{prefix}names"] = np.array(columns_of([client.hardware]))
        file = io.BytesIO()
        np.savez(file, **content)  # type: ignore[arg-type]
        try:
            write_whole(path, file.getvalue())
        except OSError as error:
            raise ConfigError(f"{path} cannot be written ({error.strerror})") from error


def _row(state: ArmState) -> list[float]:
    dq, tau = state.dq.tolist(), state.tau_nm.tolist()
    if state.gripper is not None:
        dq.append(state.gripper_rate)
        tau.append(state.gripper_tau_nm)
    return [state.stamp_s, *state.positions, *dq, *tau, *state.temp_mos_c.tolist(), *state.temp_rotor_c.tolist()]


def _unpacked(rows: array, n: int) -> dict[str, np.ndarray]:
    names = ("q", "dq", "tau_nm", "temp_mos_c", "temp_rotor_c")
    table = np.array(rows).reshape(-1, 1 + len(names) * n)
    return {"stamp_s": table[:, 0]} | {name: table[:, 1 + i * n : 1 + (i + 1) * n] for i, name in enumerate(names)}


@contextmanager
def recording(clients: Sequence[ArmClient]) -> Iterator[StateRecorder]:
    """Record in a thread while the block runs. The recording ends early when an arm is disconnected.

    Raises:
        LifeCycleError: an arm is not connected.
    """
    recorder, ended = StateRecorder(clients), threading.Event()
    recorder.poll()

    def record() -> None:
        with suppress(YamError):
            while not ended.wait(_POLL_S):
                recorder.poll()

    thread = threading.Thread(target=record, name="yam-recording", daemon=True)
    thread.start()
    try:
        yield recorder
    finally:
        ended.set()
        thread.join()
