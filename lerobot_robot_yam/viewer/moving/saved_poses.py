"""Saved poses: a JSON file, pose name → arm name → joint angles, and a folder of the page.

{"poses": {"above the table": {"left_robot": {"arm": "yam", "gripper": "linear_4310", "q_rad": [0.0, …],
                                              "opening": 1.0}}}}
"""

import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import viser

from lerobot_robot_yam.arm.resolved_arm import ResolvedArm
from lerobot_robot_yam.arm.validation import finite_number, finite_vector
from lerobot_robot_yam.errors import ActionError, ConfigError, LifeCycleError
from lerobot_robot_yam.system.paths import write_whole
from lerobot_robot_yam.viewer.moving.driver import Driver
from lerobot_robot_yam.viewer.serving.handles import kept, pressed, put

_MOST_BYTES = 1 << 20
_MOST_NAME = 60
_NONE = "(no pose is saved)"

Pose = dict[str, np.ndarray]
"""Arm name → positions (n,) of its motors: rad, and 0 … 1 for the gripper."""


class SavedPoses:
    """Saved poses of one file.

    Args:
        path: path of the file, which need not exist.
        arms: arms that the page drives. Poses of other arms stay in the file but are not offered.

    Raises:
        ConfigError: the file is unreadable, or a pose does not match its arm; the message names the pose.
    """

    def __init__(self, path: Path, arms: Sequence[ResolvedArm]):
        self.path, self._arms = path, {arm.name: arm for arm in arms}
        self._rows: dict[str, dict[str, Any]] = self._read() if path.exists() else {}
        self._poses = {name: self._pose(name, rows) for name, rows in self._rows.items()}

    @property
    def names(self) -> list[str]:
        """Names of the poses that contain at least one of these arms."""
        return [name for name, pose in self._poses.items() if pose]

    def __getitem__(self, name: str) -> Pose:
        """Return a pose. Raises ActionError: no saved pose has this name."""
        if not self._poses.get(name):
            raise ActionError(f"there is no saved pose {name!r}; nothing moves")
        return self._poses[name]

    def save(self, name: str, pose: Pose) -> None:
        """Save a pose. An existing pose with the same name is replaced.

        Raises:
            ActionError: the name is empty, too long or not printable. Nothing is saved.
            ConfigError: the pose does not match these arms, or the file cannot be written.
        """
        name = name.strip()
        if not 0 < len(name) <= _MOST_NAME or not name.isprintable():
            raise ActionError(f"give the pose a name of 1 to {_MOST_NAME} characters; nothing was saved")
        rows = {arm: self._row(self._arms[arm], values) for arm, values in pose.items()}
        checked = self._pose(name, rows)
        self._write({**self._rows, name: {**self._rows.get(name, {}), **rows}})
        self._poses[name] = checked

    def forget(self, name: str) -> None:
        """Delete a pose. Raises ActionError: no saved pose has this name; ConfigError: the file cannot be written."""
        self[name]
        self._write({key: rows for key, rows in self._rows.items() if key != name})
        del self._poses[name]

    def _write(self, rows: dict[str, dict[str, Any]]) -> None:
        try:
            write_whole(self.path, json.dumps({"poses": rows}, indent=1, ensure_ascii=False) + "\n")
        except OSError as error:
            raise ConfigError(f"{self.path}: the pose cannot be saved: {error}") from error
        self._rows = rows

    def _read(self) -> dict[str, dict[str, Any]]:
        try:
            with open(self.path, "rb") as file:
                content = json.loads(file.read(_MOST_BYTES))
        except (OSError, ValueError, RecursionError) as error:
            raise ConfigError(f"{self.path}: the saved poses cannot be read: {error}; move the file away") from error
        poses = content.get("poses") if isinstance(content, dict) else None
        if not isinstance(poses, dict) or not all(isinstance(rows, dict) for rows in poses.values()):
            raise ConfigError(f'{self.path}: this is no file of saved poses, {{"poses": {{name: {{arm: …}}}}}}')
        return poses

    def _pose(self, name: str, rows: Mapping[str, Any]) -> Pose:
        return {
            arm: self._values(f"{self.path}, pose {name!r}, {arm}", self._arms[arm], row)
            for arm, row in rows.items()
            if arm in self._arms
        }

    @staticmethod
    def _row(arm: ResolvedArm, values: np.ndarray) -> dict[str, Any]:
        row: dict[str, Any] = {"arm": arm.arm.name, "gripper": arm.gripper.name}
        row["q_rad"] = [round(value, 5) for value in values[: arm.joints].tolist()]
        if arm.has_gripper:
            row["opening"] = round(float(values[-1]), 4)
        return row

    @staticmethod
    def _values(where: str, arm: ResolvedArm, row: object) -> np.ndarray:
        """Return the positions (n,) of an arm from a saved row. Raises ConfigError: the row does not match the arm."""
        if not isinstance(row, dict) or (row.get("arm"), row.get("gripper")) != (arm.arm.name, arm.gripper.name):
            raise ConfigError(f"{where}: this is no pose of {arm.arm.name} with {arm.gripper.name}")
        try:
            values = finite_vector(where, "q_rad", row.get("q_rad"), arm.joints)
            if arm.has_gripper:
                values = np.append(values, finite_number(where, "opening", row.get("opening")))
        except ActionError as error:
            raise ConfigError(str(error)) from error
        beyond = (values < arm.lower - 1e-4) | (values > arm.upper + 1e-4)
        if beyond.any():
            motor = int(beyond.argmax())
            raise ConfigError(
                f"{where}: {arm.motors[motor].name} at {values[motor]:.3f} is beyond its limits, "
                f"{arm.lower[motor]:.2f} … {arm.upper[motor]:.2f}"
            )
        return np.clip(values, arm.lower, arm.upper)


class PosePanel:
    """Folder with controls to move the arms to a saved pose, save the current pose, and delete a pose."""

    def __init__(self, gui: viser.GuiApi, driver: Driver, poses: SavedPoses):
        self._driver, self._poses = driver, poses
        with gui.add_folder("poses"):
            self._chosen = kept(gui.add_dropdown("pose", poses.names or [_NONE]), driver.desk.is_free_for)
            pressed(gui.add_button("go to it"), self._with(self._chosen, self._go))
            name = kept(gui.add_text("name", ""), driver.desk.is_free_for)
            pressed(gui.add_button("save the present pose"), self._with(name, self._save))
            pressed(gui.add_button("forget it"), self._with(self._chosen, self._forget))

    def _with(self, control: Any, work: Callable[[str], None]) -> Callable[[int], None]:
        """Return a button handler that queues `work` with the control's value at the time of the press."""

        def asked(browser: int) -> None:
            shown = str(control.value)
            self._driver.ask(browser, lambda: work(shown))

        return asked

    def _go(self, name: str) -> None:
        self._driver.glide(self._poses[name])

    def _save(self, name: str) -> None:
        arms = self._driver.arms
        if not arms:
            raise LifeCycleError("the arms are not connected; nothing was saved")
        present = {
            name: np.clip(arm.client.observe().positions, arm.hardware.lower, arm.hardware.upper)
            for name, arm in arms.items()
        }
        self._poses.save(name, present)
        self._offer(name.strip())
        self._driver.say(None, f"saved in {self._poses.path}")

    def _forget(self, name: str) -> None:
        self._poses.forget(name)
        self._offer()

    def _offer(self, chosen: str | None = None) -> None:
        names = self._poses.names or [_NONE]
        self._chosen.options = names
        put(self._chosen, value=names[0] if chosen is None else chosen)
