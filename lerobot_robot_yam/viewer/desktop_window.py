"""MuJoCo's own viewer window for the arms that run on this computer; it can drive the arms of its own session.

All arms are in one MuJoCo model. Its joints are set from the measured states; nothing is simulated. While control is
on, each driven arm follows the box that a person drags.
"""

import queue
import time
import warnings
from collections.abc import Collection, Mapping, Sequence

import glfw
import mujoco
import mujoco.viewer
import numpy as np

from lerobot_robot_yam.arm.kinematics import PoseTracker, YamKinematics
from lerobot_robot_yam.arm.model import build_spec
from lerobot_robot_yam.arm.resolved_arm import ResolvedArm
from lerobot_robot_yam.errors import ConfigError, LifeCycleError, YamError
from lerobot_robot_yam.rig.world.world_model import add_scenery
from lerobot_robot_yam.session.arm_client import ArmClient
from lerobot_robot_yam.session.arm_session import ArmSession
from lerobot_robot_yam.state.arm_state import ArmState
from lerobot_robot_yam.state.modes import Mode
from lerobot_robot_yam.viewer.live.arm_panel import warnings as warnings_of
from lerobot_robot_yam.viewer.live.placement import row_of
from lerobot_robot_yam.viewer.live.watched_arms import WatchedArms

_GRIP_M = 0.045  # half the edge length of the drag box, m: the box encloses the 36 mm gripper motor
_GRIP_RGBA = (0.95, 0.5, 0.1, 0.5)
_REACH_RAD = 0.7  # maximum rotation of a joint per pose, rad: keeps the arm from swinging round to its other side
_ATTEMPTS = 4
_DRIVEN = (Mode.HOLD, Mode.TRACK)
_PERIOD_S = 0.02
_SPACE = 32  # GLFW's key code of the space bar
HELP = (
    "SPACE: watch or control. To move a tool: double-click its orange box, then Ctrl and drag (right: move, left: turn)"
)


class DesktopScene:
    """MuJoCo model and data of the scene in the window.

    Args:
        arms: channel key → arm.
        grips: channel keys of the arms that get a drag box at the tool.

    Attributes:
        model, data: MuJoCo's model and data for the viewer.
    """

    def __init__(self, arms: Mapping[str, ResolvedArm], grips: Collection[str] = ()):
        spec = mujoco.MjSpec()
        spec.modelname = "yam-view"
        spec.compiler.degree = False
        spec.option.gravity = [0.0, 0.0, 0.0]
        add_scenery(spec)
        self._arms = dict(sorted(arms.items()))
        self._bases: dict[str, np.ndarray] = {}
        for (key, hardware), (position, quat) in zip(self._arms.items(), row_of(self._arms.values()), strict=True):
            self._bases[key] = _pose(position, quat)
            frame = spec.worldbody.add_frame(pos=position, quat=quat)
            spec.attach(build_spec(hardware.arm, hardware.gripper), prefix=f"{key}/", frame=frame)
        for key in grips:
            if key in self._arms:
                grip = spec.worldbody.add_body(name=_grip(key), mocap=True)
                grip.add_geom(
                    type=mujoco.mjtGeom.mjGEOM_BOX, size=[_GRIP_M] * 3, rgba=_GRIP_RGBA, contype=0, conaffinity=0
                )
        self.model = spec.compile()
        self.data = mujoco.MjData(self.model)
        mujoco.mj_forward(self.model, self.data)

    def show(self, key: str, q: np.ndarray, gripper: float | None = None) -> None:
        """Set an arm's joint angles (n,), rad, and gripper opening, 0 closed … 1 open. Call `refresh` afterwards."""
        hardware, values = self._arms[key], self.data.qpos
        first = int(self.model.joint(f"{key}/joint1").qposadr[0]) if hardware.joints else 0
        values[first : first + hardware.joints] = np.nan_to_num(q)
        travel = hardware.gripper.finger_range_m
        if travel is not None:
            closed, opened = travel
            opening = float(np.clip(np.nan_to_num(gripper or 0.0), 0.0, 1.0))
            for finger in hardware.gripper.finger_joints:
                values[self.model.joint(f"{key}/{finger}").qposadr[0]] = closed + opening * (opened - closed)

    def refresh(self) -> None:
        """Compute the poses of all bodies from the joint angles."""
        mujoco.mj_forward(self.model, self.data)

    def tool(self, key: str) -> np.ndarray:
        """Return the pose (4, 4) of tcp_site in the arm's base frame, as of the last `refresh`."""
        site = self.data.site(f"{key}/tcp_site")
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = site.xmat.reshape(3, 3), site.xpos
        return np.linalg.inv(self._bases[key]) @ pose

    def grip(self, key: str) -> np.ndarray:
        """Return the pose (4, 4) of the drag box in the arm's base frame."""
        number = self._mocap(key)
        return np.linalg.inv(self._bases[key]) @ _pose(self.data.mocap_pos[number], self.data.mocap_quat[number])

    def put_grip(self, key: str, pose: np.ndarray) -> None:
        """Set the pose (4, 4) of the drag box in the arm's base frame."""
        number, place, quat = self._mocap(key), self._bases[key] @ pose, np.empty(4)
        mujoco.mju_mat2Quat(quat, place[:3, :3].ravel())
        self.data.mocap_pos[number], self.data.mocap_quat[number] = place[:3, 3], quat

    def _mocap(self, key: str) -> int:
        return int(self.model.body(_grip(key)).mocapid[0])


def _grip(key: str) -> str:
    return f"drag {key}"


def _pose(position: np.ndarray, quat: np.ndarray) -> np.ndarray:
    turn, pose = np.empty(9), np.eye(4)
    mujoco.mju_quat2Mat(turn, np.asarray(quat, dtype=float))
    pose[:3, :3], pose[:3, 3] = turn.reshape(3, 3), position
    return pose


class DragControl:
    """Control of arms by dragging boxes. Control is off until `toggle` is called.

    The control loop applies its own limits, workspace and collision guard, and holds the arm when targets cease.

    Args:
        session: started session whose arms hold.
        names: names of the session's followers to drive.

    Attributes:
        on: whether the arms follow the boxes.
        said: reason why control ended by itself; empty if a person ended it.
    """

    def __init__(self, session: ArmSession, names: Sequence[str]):
        self._clients: dict[str, ArmClient] = {session.key(name): session[name] for name in names}
        self._kinematics = {
            key: YamKinematics(client.hardware.arm, client.hardware.gripper) for key, client in self._clients.items()
        }
        self._trackers = {key: PoseTracker(own, own.middle) for key, own in self._kinematics.items()}
        self.on = False
        self.said = ""

    @property
    def keys(self) -> list[str]:
        """Channel keys of the driven arms."""
        return list(self._clients)

    def toggle(self) -> None:
        """Switch between control and watching."""
        if self.on:
            self.watch()
            return
        try:
            for key, client in self._clients.items():
                self._trackers[key].restart(self._ready(client).setpoint_q)
            self.on, self.said = True, ""
        except YamError as error:
            self.said = str(error)

    def watch(self, why: str = "") -> None:
        """Stop driving; the driven arms then hold. `why`: reason to show to the person."""
        self.said = why
        for client in self._clients.values() if self.on else ():
            try:
                if client.mode() in _DRIVEN:
                    client.hold()
            except YamError as error:
                self.said = str(error)
        self.on = False

    def update(self, scene: DesktopScene) -> None:
        """Send a target to each arm. While control is off, move each box to the tool pose of the set-point instead."""
        try:
            for key, client in self._clients.items():
                if not self.on:
                    scene.put_grip(key, self._kinematics[key].fk(client.observe().setpoint_q))
                    continue
                self._ready(client)
                found = self._trackers[key].solve(scene.grip(key), attempts=_ATTEMPTS, within_rad=_REACH_RAD)
                client.write_target(found.q)
        except YamError as error:
            self.watch(str(error))

    def _ready(self, client: ArmClient) -> ArmState:
        """Return the state of an arm. Raises YamError: the arm does not accept targets."""
        state = client.observe()
        if state.mode not in _DRIVEN:
            raise LifeCycleError(f"{client.config.name} is in {state.mode.name}: it takes no targets")
        return state


def need_display() -> None:
    """Raise ConfigError if no window can be opened. Without this check, MuJoCo's viewer would wait forever."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        opened = glfw.init()
    if not opened:
        _, why = glfw.get_error()
        text = why.decode(errors="replace") if isinstance(why, bytes) else "no display"
        raise ConfigError(f"--desktop needs a screen ({text}); without one use yam-view and a browser")


class Desktop:
    """Contents of the window, independent of the window itself. `control`: control of the driven arms, or None."""

    def __init__(self, control: DragControl | None = None):
        self._control = control
        self._watched = WatchedArms()
        self._typed: queue.SimpleQueue[int] = queue.SimpleQueue()
        self._shown: dict[str, str] = {}
        self.scene = DesktopScene({})
        self.look()

    def look(self) -> bool:
        """Update the states of all arms. If other arms run than before, build a new scene and return True."""
        self._watched.update(time.monotonic())
        known = {key: arm.hardware for key, arm in self._watched.arms.items() if arm.hardware is not None}
        shown = {key: self._watched.arms[key].process for key in known}
        if shown == self._shown:
            return False
        self._shown = shown
        if self._control is not None and self._control.on:
            self._control.watch("other arms have come or gone")
        self.scene = DesktopScene(known, self._control.keys if self._control else ())
        return True

    def type(self, key: int) -> None:
        """Queue a key press, given by its GLFW key code. Any thread may call this."""
        self._typed.put(key)

    def update(self) -> None:
        """Show the newest state of each arm, and send targets to the driven arms."""
        for key in self._shown:
            arm = self._watched.arms.get(key)
            if arm is not None and arm.state is not None:
                self.scene.show(key, arm.state.q, arm.state.gripper)
        self.scene.refresh()
        while not self._typed.empty():
            if self._typed.get() == _SPACE and self._control is not None:
                self._control.toggle()
        if self._control is not None and set(self._control.keys) <= set(self._shown):
            self._control.update(self.scene)

    def texts(self) -> tuple[str, str]:
        """Return the left and right text columns for the window's corner."""
        left = "watching" if self._control is None or not self._control.on else "CONTROL"
        lines = [f"{arm.name}: {line}" for arm in self._watched.arms.values() for line in warnings_of(arm)]
        if not self._watched.arms:
            lines.append("no arm runs on this computer")
        if self._control is not None:
            lines += [self._control.said] * bool(self._control.said) + [HELP]
        return left, "\n".join(lines)

    def close(self) -> None:
        """Close the watched sessions. Idempotent."""
        self._watched.close()


def run_desktop(control: DragControl | None = None) -> None:
    """Show a window until a person closes it. When arms appear or disappear, a new window replaces the old one."""
    desktop = Desktop(control)
    try:
        while _one_window(desktop):
            pass
    finally:
        desktop.close()


def _one_window(desktop: Desktop) -> bool:
    """Show the current scene in a window; return whether a new window is needed."""
    scene = desktop.scene
    with mujoco.viewer.launch_passive(
        scene.model, scene.data, key_callback=desktop.type, show_left_ui=False, show_right_ui=False
    ) as window:
        window.cam.lookat, window.cam.distance, window.cam.azimuth, window.cam.elevation = [0.2, 0, 0.2], 1.8, 140, -25
        while window.is_running():
            if desktop.look():
                return True
            with window.lock():
                desktop.update()
            window.set_texts((None, None, *desktop.texts()))
            window.sync()
            time.sleep(_PERIOD_S)
    return False
