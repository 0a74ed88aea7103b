"""Poses that a person has saved: a JSON file, by name of the pose and of the arm.

{"poses": {"above the table": {"left_robot": {"arm": "yam", "gripper": "linear_4310", "q_rad": [0.0, …],
                                              "opening": 1.0}}}}
"""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from lerobot_robot_yam.arm.resolved_arm import ResolvedArm
from lerobot_robot_yam.arm.validation import finite_number, finite_vector
from lerobot_robot_yam.errors import ActionError, ConfigError
from lerobot_robot_yam.system.paths import write_whole

_MOST_BYTES = 1 << 20
_MOST_NAME = 60

Pose = dict[str, np.ndarray]
"""Per arm, by name, (n,) of its motors: rad, and 0 … 1 of the gripper."""


class SavedPoses:
    """The poses in one file.

    Args:
        path: the file; it need not exist.
        arms: that the page drives. Poses of others are kept in the file, and not offered.

    Raises:
        ConfigError: the file cannot be read, or holds what is no pose of these arms: names it.
    """

    def __init__(self, path: Path, arms: Sequence[ResolvedArm]):
        self.path, self._arms = path, {arm.name: arm for arm in arms}
        self._rows: dict[str, dict[str, Any]] = self._read() if path.exists() else {}
        self._poses = {name: self._pose(name, rows) for name, rows in self._rows.items()}

    @property
    def names(self) -> list[str]:
        """Of the poses that say something about these arms."""
        return [name for name, pose in self._poses.items() if pose]

    def __getitem__(self, name: str) -> Pose:
        """Raises ActionError: there is no such pose."""
        if not self._poses.get(name):
            raise ActionError(f"there is no saved pose {name!r}; nothing moves")
        return self._poses[name]

    def save(self, name: str, pose: Pose) -> None:
        """Save a pose; one of that name is replaced.

        Raises:
            ActionError: the name is empty or too long, or it is no pose of these arms; nothing is saved.
            ConfigError: the file cannot be written.
        """
        name = name.strip()
        if not 0 < len(name) <= _MOST_NAME or not name.isprintable():
            raise ActionError(f"give the pose a name of 1 to {_MOST_NAME} characters; nothing was saved")
        rows = {arm: self._row(self._arms[arm], values) for arm, values in pose.items()}
        checked = self._pose(name, rows)
        self._write({**self._rows, name: {**self._rows.get(name, {}), **rows}})
        self._poses[name] = checked

    def forget(self, name: str) -> None:
        """Remove a pose. Raises ActionError: there is none of that name; ConfigError: the file cannot be written."""
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
        """(n,) of one arm. Raises ConfigError: it is no pose of this arm."""
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
