"""Backend for Waldo Commander, which finds it through the entry point `yam` in the group `waldoctl.robots`.

Creating a `Robot` opens no socket and starts no process. `start` starts a controller process, which energises nothing.
"""

import dataclasses
import json
import os
import signal
import socket
import sys
import time
from collections.abc import Sequence
from functools import cached_property
from typing import Any

import numpy as np
import waldoctl
from waldoctl import (
    CartesianKinodynamicLimits,
    HomePosition,
    IKResultData,
    JointLimits,
    JointsSpec,
    KinodynamicLimits,
    LinearAngularLimits,
    PositionLimits,
)

from lerobot_robot_yam.arm.config import ArmConfig
from lerobot_robot_yam.errors import ControllerError, YamError
from lerobot_robot_yam.session.runners import LAND_TIMEOUT_S
from lerobot_robot_yam.waldo.arm_choice import ArmChoice, tip
from lerobot_robot_yam.waldo.arm_model import ArmModel
from lerobot_robot_yam.waldo.client.async_client import AsyncRobotClient
from lerobot_robot_yam.waldo.client.dry_run_client import DryRunClient
from lerobot_robot_yam.waldo.client.sync_client import RobotClient
from lerobot_robot_yam.waldo.planning.motion_plan import (
    JOG_SHARE,
    LINE_ACCELERATION_M_S2,
    LINE_ACCELERATION_RAD_S2,
    LINE_SPEED_M_S,
    LINE_SPEED_RAD_S,
)
from lerobot_robot_yam.waldo.planning.planner import Planner
from lerobot_robot_yam.waldo.poses import FRAMES, from_vector, to_vector
from lerobot_robot_yam.waldo.program import PROFILES
from lerobot_robot_yam.waldo.tool_catalog import YamTools, model_of, tools_of
from lerobot_robot_yam.waldo.wire import ANSWER_S, HOST, PORT, ask_once

_CONTROLLER = "lerobot_robot_yam.waldo.controller.controller_process"
_LOOK_S = 0.05  # polling period while a controller starts or ends, s
_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


class Robot(waldoctl.Robot):
    """YAM arm for Commander. Poses are in m and rad, of the flange, or of the tool's tip once a tool is set.

    Args:
        arm, gripper: profile names; None: as given by the environment, see `ArmChoice`.
        options: other options of a host application, which are ignored.

    Raises:
        ConfigError: the arm or gripper is unknown.
    """

    position_unit = "mm"
    digital_outputs = digital_inputs = 0
    joint_index_mapping = tuple(range(6))  # the URDF has the joints in our order
    backend_package = "lerobot_robot_yam"
    sync_client_class, async_client_class = RobotClient, AsyncRobotClient
    motion_profiles, cartesian_frames = PROFILES, FRAMES
    cartesian_limits = CartesianKinodynamicLimits(
        LinearAngularLimits(LINE_SPEED_M_S, LINE_SPEED_RAD_S),
        LinearAngularLimits(LINE_ACCELERATION_M_S2, LINE_ACCELERATION_RAD_S2),
    )
    has_freedrive = has_collision_checking = True

    def __init__(self, arm: str | None = None, gripper: str | None = None, **options: Any):
        choice = ArmChoice.of_environment()
        self._choice = ArmChoice(arm or choice.arm, gripper or choice.gripper)
        self._hardware = self._choice.resolved()
        self._planner = Planner(self._hardware)
        self._controller: int | None = None  # process id of the controller started by process `_owner`
        self._owner = 0

    @property
    def name(self) -> str:
        """Display name."""
        return f"{self._choice.arm} with {self._choice.gripper}"

    @cached_property
    def joints(self) -> JointsSpec:
        """Names, limits and home pose of the six joints."""
        planner, n = self._planner, self._hardware.joints
        range_rad = np.stack([planner.lower, planner.upper], axis=1)
        hard, jog = (KinodynamicLimits(*planner.limits.scaled(share, 1.0)) for share in (1.0, JOG_SHARE))
        limits = JointLimits(PositionLimits(np.degrees(range_rad), range_rad), hard, jog)
        home = HomePosition(np.degrees(planner.home_q), planner.home_q)
        return JointsSpec(n, tuple(self._hardware.joint_names), limits, home)

    @cached_property
    def native_tools(self) -> YamTools:
        """Tools of the arm: the bare flange, and the mounted gripper."""
        return tools_of(self._choice)

    if "tools" in getattr(waldoctl.Robot, "__abstractmethods__", ()):  # needed by older versions of waldoctl

        @property
        def tools(self) -> YamTools:
            """Same as `native_tools`."""
            return self.native_tools

    @cached_property
    def _model(self) -> ArmModel:
        model = model_of(self._choice)
        model.write()
        return model

    @property
    def urdf_path(self) -> str:
        """Absolute path of the URDF, which is generated from the profiles on first use."""
        return str(self._model.urdf_path)

    @property
    def mesh_dir(self) -> str:
        """Absolute path of the folder with the STL files."""
        return str(self._model.mesh_dir)

    def fk(self, q_rad: np.ndarray, out: np.ndarray) -> np.ndarray:
        """Write the pose x y z rx ry rz for joints (6,) into `out` (6,); return `out`."""
        out[:] = self.fk_batch(q_rad)
        return out

    def fk_batch(self, joint_path_rad: np.ndarray) -> np.ndarray:
        """Return poses (N, 6) for joints (N, 6)."""
        return to_vector(self._planner.pose(joint_path_rad))

    def ik(self, pose: np.ndarray, q_seed_rad: np.ndarray) -> IKResultData:
        """Return joints near the seed (6,) that bring the tool to a pose (6,), or a failed result if out of reach."""
        try:
            q = self._planner.inverse(from_vector(pose), np.asarray(q_seed_rad, dtype=float))
        except YamError as error:
            return IKResultData(np.array(q_seed_rad, dtype=float), False, str(error))
        return IKResultData(q, True)

    def ik_batch(self, poses: np.ndarray, q_start_rad: np.ndarray) -> list[IKResultData]:
        """Return one IK result per pose (N, 6), each seeded with the previous result."""
        results: list[IKResultData] = []
        for pose in poses:
            results.append(self.ik(pose, results[-1].q if results else q_start_rad))
        return results

    def set_active_tool(
        self, tool_key: str, tcp_offset_m: Sequence[float] | None = None, variant_key: str | None = None
    ) -> None:
        """Select the tool whose tip the poses refer to. Raises ConfigError: the arm has no tool with this key."""
        offset = np.array((0.0,) * 3 if tcp_offset_m is None else tcp_offset_m, dtype=float)
        self._planner.kinematics.tool = tip(self._hardware.gripper, tool_key, offset)

    def check_limits(self, q_rad: np.ndarray) -> bool:
        """Return whether all joints (6,) are within their limits."""
        try:
            self._planner.within(q_rad)
        except YamError:
            return False
        return True

    def start(self, **kwargs: Any) -> None:
        """Start a controller process and wait until it replies. It energises nothing, and ends with this process.

        This uses `posix_spawn`. `subprocess.Popen` would wait for the end of a pipe, which a worker process that
        Commander forks at the same time may keep open forever.

        Args:
            kwargs: host, port; com_port: CAN channel of the real arm, or ''; timeout, s.

        Raises:
            ControllerError: the port is in use, or the controller did not start in time.
        """
        host, port = kwargs.get("host", HOST), int(kwargs.get("port", PORT))
        channel, timeout_s = kwargs.get("com_port") or "", float(kwargs.get("timeout", 60.0))
        if _serves(host, port):
            raise ControllerError(f"somebody serves {host}:{port} already; end that, or choose another port")
        self._owner = os.getpid()
        arguments = ["--host", host, "--port", str(port), "--parent", str(self._owner)]
        if channel:
            config = ArmConfig(channel=channel, name=channel, arm=self._choice.arm, gripper=self._choice.gripper)
            arguments += ["--arm-config", json.dumps(dataclasses.asdict(config))]
        self._controller = os.posix_spawn(
            sys.executable,
            [sys.executable, "-P", "-m", _CONTROLLER, *arguments],
            {**os.environ, **self._choice.environment()},
            file_actions=[(os.POSIX_SPAWN_OPEN, 0, os.devnull, os.O_RDONLY, 0), (os.POSIX_SPAWN_DUP2, 2, 1)],
            setsid=True,
            setsigmask=[],
            setsigdef=_SIGNALS,
        )
        deadline = time.monotonic() + timeout_s
        while (ask_once(host, port, "ping") or {}).get("pid") != self._controller:
            if self._ended():
                raise ControllerError(f"the controller for {host}:{port} ended at its start; see its message above")
            if time.monotonic() > deadline:
                self.stop()
                raise ControllerError(f"the controller for {host}:{port} did not come up within {timeout_s:g} s")
            time.sleep(_LOOK_S)

    def _ended(self) -> bool:
        """Return whether no controller started by this object is running."""
        if self._controller is not None:
            try:
                ended = os.waitpid(self._controller, os.WNOHANG)[0] == self._controller
            except ChildProcessError:  # already reaped by Commander
                ended = True
            self._controller = None if ended else self._controller
        return self._controller is None

    def stop(self) -> None:
        """Stop the controller started by this object, if any. The controller lands the arm before it ends.

        Idempotent. Does nothing in a forked child process.

        Raises:
            ControllerError: the arm has not landed in time.
        """
        if os.getpid() != self._owner or self._ended():
            return
        assert self._controller is not None
        os.kill(self._controller, signal.SIGTERM)
        deadline = time.monotonic() + LAND_TIMEOUT_S
        while not self._ended():
            if time.monotonic() > deadline:
                raise ControllerError("the arm is not down yet; its controller goes on landing it by itself")
            time.sleep(_LOOK_S)

    def is_available(self, **kwargs: Any) -> bool:
        """Return whether a controller with this arm and gripper replies."""
        found = ask_once(kwargs.get("host", HOST), int(kwargs.get("port", PORT)), "ping")
        ours = self._hardware.arm.name, self._hardware.gripper.name
        return bool(found) and (found["arm"], found["gripper"]) == ours

    def create_async_client(self, **kwargs: Any) -> AsyncRobotClient:
        """Create a client for Commander's page. No connection is opened."""
        return AsyncRobotClient(**kwargs)

    def create_sync_client(self, **kwargs: Any) -> RobotClient:
        """Create a client for scripts. No connection is opened."""
        return RobotClient(**kwargs)

    def create_dry_run_client(self, **kwargs: Any) -> DryRunClient:
        """Create a client that plans motions without executing them."""
        return DryRunClient(**kwargs)


def _serves(host: str, port: int) -> bool:
    """Return whether the port accepts connections."""
    try:
        socket.create_connection((host, port), ANSWER_S).close()
    except OSError:
        return False
    return True
