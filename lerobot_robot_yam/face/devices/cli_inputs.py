"""What a LeRobot command names: whether it is there, said before anything is opened or energised."""

import difflib
import sys
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

from lerobot.utils.constants import OBS_IMAGES

from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.face.devices.cli_options import channels_of
from lerobot_robot_yam.face.recorder.record_command import INFO, episodes_in, is_empty

_RECORD = ("lerobot-record", "lerobot_record")
_HUB_S = 5.0
_PARQUET_END = b"PAR1"
_FILLED = "empty_camera"  # LeRobot's names of images that policies get as zeros
_FILLING = ("pi0", "pi05", "pi0_fast", "smolvla", "xvla", "evo1")  # LeRobot's types that do so with any that is missing


def check_channels() -> None:
    """Refuse a channel that two arms of the command have.

    Raises:
        ConfigError: names both options.
    """
    found: dict[str, str] = {}
    for device in ("robot", "teleop"):
        for option, channel in channels_of(device).items():
            if channel in found:
                raise ConfigError(
                    f"channel {channel} is given twice, by {found[channel]} and {option}; each arm has its own"
                )
            found[channel] = option


def check_data_set(options: Mapping[str, str]) -> None:
    """Refuse a folder (`dataset.root`) that does not hold what the command opens, or holds what it would make.

    Raises:
        ConfigError: says what is there.
    """
    if not options.get("dataset.root"):
        return  # in LeRobot's own directory, or to be fetched
    root = Path(options["dataset.root"])
    episodes = episodes_in(root)
    opens = "dataset.episode" in options or options.get("resume") == "True"
    if opens and episodes is None and not _on_hub(options.get("dataset.repo_id", "")):
        beside = sorted(path.parent.parent.name for path in root.parent.glob(f"*/{INFO}"))
        there = f"{root.parent} has {', '.join(beside)}" if beside else f"{root.parent} has none"
        raise ConfigError(f"there is no data set in {root}; {there}")
    if opens and episodes == 0:
        raise ConfigError(f"the data set in {root} has no episode; {_clean(root)}")
    if opens and episodes and _is_torn(root):
        raise ConfigError(f"the data set in {root} was not closed, and does not load; `yam-repair-dataset {root}`")
    if episodes and int(options.get("dataset.episode") or 0) >= episodes:
        raise ConfigError(f"{root} has no episode {options['dataset.episode']}, but 0 to {episodes - 1}")
    if not opens and Path(*sys.argv[:1]).stem in _RECORD and root.exists():
        holds = f"holds {episodes} episodes; add --resume=true to record more, or choose another dataset.root"
        if episodes is None:
            holds = "is no data set; choose another dataset.root"
        elif episodes == 0:
            holds = f"holds no episode; {_clean(root)}"
        raise ConfigError(f"{root} is there already and {holds}")


def _is_torn(root: Path) -> bool:
    """Whether a recording was killed: LeRobot would look for the data set on the Hub, without a word of that."""
    episodes = list(root.glob("meta/episodes/**/*.parquet"))
    tables = [*episodes, *root.glob("data/**/*.parquet")]
    return not episodes or not all(_is_closed(path) for path in tables)


def _is_closed(table: Path) -> bool:
    with table.open("rb") as file:
        file.seek(max(0, table.stat().st_size - len(_PARQUET_END)))
        return file.read() == _PARQUET_END


def _clean(root: Path) -> str:
    """How to get rid of a data set without an episode."""
    if is_empty(root):
        return f"remove it (rm -r {root}) and record"
    return f"there are rows or images of one all the same: `yam-repair-dataset {root}`"


def _on_hub(repo_id: str) -> bool:
    """Whether LeRobot could fetch it."""
    from huggingface_hub import HfApi

    try:
        HfApi().dataset_info(repo_id, timeout=_HUB_S)
    except Exception:  # no such data set, no network, no name of one
        return False
    return True


def check_cameras(policy: str, config: Mapping[str, Any], cameras: Collection[str]) -> None:
    """Refuse a policy that sees cameras which the robot lacks. Some policies take zeros for all but one.

    Raises:
        ConfigError: names them, and what the robot has.
    """
    names = [name.removeprefix(f"{OBS_IMAGES}.") for name in config.get("input_features") or {} if OBS_IMAGES in name]
    wanted = [name for name in names if not name.startswith(_FILLED)]
    missing = next((name for name in wanted if name not in cameras), None)
    if missing is None or (config.get("type") in _FILLING and not set(wanted).isdisjoint(cameras)):
        return
    near = difflib.get_close_matches(missing, list(cameras), 1)
    meant = f"is {near[0]!r} its {missing!r}? Rename it" if near else f"configure {missing!r} under robot.cameras"
    raise ConfigError(
        f"{policy} sees the cameras {', '.join(wanted)}, this robot has {', '.join(cameras) or 'none'}; {meant}"
    )
