"""Kinds of defects that the check of a data set knows: one table, which docs/dataset-check.md shows too."""

from dataclasses import dataclass
from enum import StrEnum
from typing import Any


class Kind(StrEnum):
    """Name of a kind of defect."""

    UNREADABLE = "unreadable"
    COUNTS = "counts"
    STATISTICS = "statistics"
    NO_ROWS = "no_rows"
    NO_METADATA = "no_metadata"
    LENGTH = "length"
    FRAMES = "frames"
    INDEX = "index"
    TASK = "task"
    SHORT = "short"
    NOT_MONOTONE = "not_monotone"
    CADENCE = "cadence"
    REAL_RATE = "real_rate"
    LATE = "late"
    NOT_FINITE = "not_finite"
    UNITS = "units"
    JOINT_LIMITS = "joint_limits"
    GRIPPER_RANGE = "gripper_range"
    ACTION_JUMP = "action_jump"
    STATE_JUMP = "state_jump"
    ACTION_CONSTANT = "action_constant"
    ACTION_FROZEN = "action_frozen"
    STATE_FROZEN = "state_frozen"
    ARMS_SWAPPED = "arms_swapped"
    FAR_APART = "far_apart"
    APPROACH = "approach"
    VIDEO_MISSING = "video_missing"
    VIDEO_SHORT = "video_short"
    VIDEO_BROKEN = "video_broken"
    CAMERA_FROZEN = "camera_frozen"
    CAMERA_SLOW = "camera_slow"
    CAMERA_DARK = "camera_dark"
    CAMERA_BRIGHT = "camera_bright"
    CAMERAS_ALIKE = "cameras_alike"
    CAMERAS_SWAPPED = "cameras_swapped"


@dataclass(frozen=True)
class Flag:
    """One defect.

    Attributes:
        kind: kind of the defect.
        text: the finding, with numbers.
        frames: first and last frame of the episode that show it, None if no frames do.
    """

    kind: Kind
    text: str
    frames: tuple[int, int] | None = None

    def to_dict(self) -> dict[str, Any]:
        return {"kind": str(self.kind), "text": self.text, "frames": list(self.frames) if self.frames else None}


_DELETE = "delete the episode"
_RECORD = "delete the episode, and repair the cause before you record on"
_REPAIR = "`yam-repair-dataset`"
_CABLES = "look at the cameras' names and ports in the config"

KINDS: dict[Kind, tuple[str, str]] = {
    Kind.UNREADABLE: ("a file of data or metadata cannot be read", _REPAIR),
    Kind.COUNTS: ("`meta/info.json` counts other episodes or frames than there are", _REPAIR),
    Kind.STATISTICS: (
        "statistics of action or state are not those of the rows",
        "a training would scale wrongly: make them again with `lerobot-edit-dataset --operation.type recompute_stats`",
    ),
    Kind.NO_ROWS: ("an episode has metadata but no rows", _REPAIR),
    Kind.NO_METADATA: ("an episode has rows but no metadata", _REPAIR),
    Kind.LENGTH: ("the metadata say another length than there are rows", _REPAIR),
    Kind.FRAMES: ("rows are dropped or doubled: `frame_index` does not count from 0 in steps of 1", _DELETE),
    Kind.INDEX: ("`index` does not go on from the episode before", _REPAIR),
    Kind.TASK: ("rows without a task, or with an empty one", "`lerobot-edit-dataset --operation.type modify_tasks`"),
    Kind.SHORT: ("shorter than half a second", _DELETE),
    Kind.NOT_MONOTONE: ("time stamps that do not grow, or are no numbers", _DELETE),
    Kind.CADENCE: ("time stamps do not fit to the frames per second of the data set", _DELETE),
    Kind.REAL_RATE: (
        "recorded 5 % slower or faster than it is stamped",
        "the computer was too busy: end other programs; or fewer cameras, smaller pictures, a lower fps",
    ),
    Kind.LATE: ("more than 5 % of the frames came late, or one by more than half a second", _RECORD),
    Kind.NOT_FINITE: ("NaN or infinity in an action or state", _DELETE),
    Kind.UNITS: ("degrees in a data set of radians, or radians in one of degrees", _RECORD),
    Kind.JOINT_LIMITS: ("a state more than 0.1 rad outside the joint limits", "check the arm's zero (`yam-zero`)"),
    Kind.GRIPPER_RANGE: ("an opening of a gripper below -0.05 or above 1.05", "calibrate the gripper"),
    Kind.ACTION_JUMP: ("an action jumps between two frames", _RECORD),
    Kind.STATE_JUMP: ("a measured joint jumps between two frames", _RECORD),
    Kind.ACTION_CONSTANT: ("the action is the same in the whole episode", _DELETE),
    Kind.ACTION_FROZEN: ("the action stands still while the arm moves away from it", _RECORD),
    Kind.STATE_FROZEN: ("the state stands still while the action moves", _RECORD),
    Kind.ARMS_SWAPPED: (
        "the left arm does what the right action says, and the other way round",
        "swap the columns, or the leaders' channels",
    ),
    Kind.FAR_APART: ("a joint is more than 0.35 rad away from its action most of the time", _RECORD),
    Kind.APPROACH: (
        "for a quarter of a second or longer, the first frames show an arm on its way to its action",
        "cut them off",
    ),
    Kind.VIDEO_MISSING: ("a video file, or an episode's place in it, is missing", _REPAIR),
    Kind.VIDEO_SHORT: ("a video has fewer frames than the episode has rows", _REPAIR),
    Kind.VIDEO_BROKEN: ("a video cannot be decoded", _REPAIR),
    Kind.CAMERA_FROZEN: ("a camera shows the same picture for half a second or more while the arms move", _RECORD),
    Kind.CAMERA_SLOW: (
        "more than 30 % of a camera's pictures repeat the one before",
        "set a lower fps, or another mode of the camera",
    ),
    Kind.CAMERA_DARK: ("a camera has black pictures", _RECORD),
    Kind.CAMERA_BRIGHT: ("most pixels of a camera are white in most pictures", "less exposure; delete the episode"),
    Kind.CAMERAS_ALIKE: ("two cameras show the same", _CABLES),
    Kind.CAMERAS_SWAPPED: ("two cameras show what the other one shows in most episodes", _CABLES),
}
"""Kind → its meaning, and the remedy."""
