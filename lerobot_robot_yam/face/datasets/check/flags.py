"""Table of the defects that the data set check detects. docs/dataset-check.md shows the same table."""

from dataclasses import dataclass
from enum import StrEnum
from typing import Any, Self

_DELETE = "delete the episode"
_RECORD = "delete the episode, and repair the cause before you record on"
_REPAIR = "`yam-repair-dataset`"
_CABLES = "look at the cameras' names and ports in the config"


class Kind(StrEnum):
    """Kind of defect.

    Attributes:
        meaning: description of the defect.
        remedy: advice for the user.
    """

    meaning: str
    remedy: str

    def __new__(cls, name: str, meaning: str, remedy: str) -> Self:
        kind = str.__new__(cls, name)
        kind._value_, kind.meaning, kind.remedy = name, meaning, remedy
        return kind

    UNREADABLE = "unreadable", "a file of data or metadata cannot be read", _REPAIR
    COUNTS = "counts", "`meta/info.json` counts other episodes or frames than there are", _REPAIR
    STATISTICS = (
        "statistics",
        "statistics of action or state are not those of the rows",
        "a training would scale wrongly: make them again with `lerobot-edit-dataset --operation.type recompute_stats`",
    )
    NO_ROWS = "no_rows", "an episode has metadata but no rows", _REPAIR
    NO_METADATA = "no_metadata", "an episode has rows but no metadata", _REPAIR
    LENGTH = "length", "the metadata say another length than there are rows", _REPAIR
    FRAMES = "frames", "rows are dropped or doubled: `frame_index` does not count from 0 in steps of 1", _DELETE
    INDEX = "index", "`index` does not go on from the episode before", _REPAIR
    TASK = "task", "rows without a task, or with an empty one", "`lerobot-edit-dataset --operation.type modify_tasks`"
    SHORT = "short", "shorter than half a second", _DELETE
    NOT_MONOTONE = "not_monotone", "time stamps that do not grow, or are no numbers", _DELETE
    CADENCE = "cadence", "time stamps do not fit to the frames per second of the data set", _DELETE
    REAL_RATE = (
        "real_rate",
        "recorded 5 % slower or faster than it is stamped",
        "the computer was too busy: end other programs; or fewer cameras, smaller pictures, a lower fps",
    )
    LATE = "late", "more than 5 % of the frames came late, or one by more than half a second", _RECORD
    NOT_FINITE = "not_finite", "NaN or infinity in an action or state", _DELETE
    UNITS = "units", "degrees in a data set of radians, or radians in one of degrees", _RECORD
    JOINT_LIMITS = (
        "joint_limits",
        "a state more than 0.1 rad outside the joint limits",
        "check the arm's zero (`yam-zero`)",
    )
    GRIPPER_RANGE = "gripper_range", "an opening of a gripper below -0.05 or above 1.05", "calibrate the gripper"
    ACTION_JUMP = "action_jump", "an action jumps between two frames", _RECORD
    STATE_JUMP = "state_jump", "a measured joint jumps between two frames", _RECORD
    ACTION_CONSTANT = "action_constant", "the action is the same in the whole episode", _DELETE
    ACTION_FROZEN = "action_frozen", "the action stands still while the arm moves away from it", _RECORD
    STATE_FROZEN = "state_frozen", "the state stands still while the action moves", _RECORD
    ARMS_SWAPPED = (
        "arms_swapped",
        "the left arm does what the right action says, and the other way round",
        "swap the columns, or the leaders' channels",
    )
    FAR_APART = "far_apart", "a joint is more than 0.35 rad away from its action most of the time", _RECORD
    APPROACH = (
        "approach",
        "for a quarter of a second or longer, the first frames show an arm on its way to its action",
        "cut them off",
    )
    VIDEO_MISSING = "video_missing", "a video file, or an episode's place in it, is missing", _REPAIR
    VIDEO_SHORT = "video_short", "a video has fewer frames than the episode has rows", _REPAIR
    VIDEO_BROKEN = "video_broken", "a video cannot be decoded", _REPAIR
    CAMERA_FROZEN = (
        "camera_frozen",
        "a camera shows the same picture for half a second or more while the arms move",
        _RECORD,
    )
    CAMERA_SLOW = (
        "camera_slow",
        "more than 30 % of a camera's pictures repeat the one before",
        "set a lower fps, or another mode of the camera",
    )
    CAMERA_DARK = "camera_dark", "a camera has black pictures", _RECORD
    CAMERA_BRIGHT = (
        "camera_bright",
        "most pixels of a camera are white in most pictures",
        "less exposure; delete the episode",
    )
    CAMERAS_ALIKE = "cameras_alike", "two cameras show the same", _CABLES
    CAMERAS_SWAPPED = "cameras_swapped", "two cameras show what the other one shows in most episodes", _CABLES


@dataclass(frozen=True)
class Flag:
    """Defect of a data set or an episode.

    Attributes:
        kind: kind of the defect.
        text: description of the finding, with numbers.
        frames: first and last frame of the episode that show the defect; None if no single frames do.
    """

    kind: Kind
    text: str
    frames: tuple[int, int] | None = None

    def to_dict(self) -> dict[str, Any]:
        return {"kind": str(self.kind), "text": self.text, "frames": list(self.frames) if self.frames else None}
