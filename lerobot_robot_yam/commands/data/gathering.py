"""Recording of demonstrations of a virtual rig's task, in lock-step, as a LeRobot data set, for `yam-gather`.

The environment is taken from a `lerobot-eval` config, so that training and evaluation share it. A scripted operator
does the task once per seed; failed attempts are dropped.
"""

import json
import logging
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple, cast

import draccus
import numpy as np
from draccus.utils import DecodingError, ParsingError
from lerobot.configs.eval import EvalPipelineConfig
from lerobot.configs.video import RGBEncoderConfig
from lerobot.datasets.lerobot_dataset import LeRobotDataset
from lerobot.utils.constants import ACTION, OBS_IMAGES, OBS_STATE
from tqdm import tqdm

from lerobot_robot_yam.config_yam_env import AGENT_POS, YamEnvConfig, eyes_of
from lerobot_robot_yam.errors import ConfigError, RigError
from lerobot_robot_yam.face.datasets.recording import recorded_name
from lerobot_robot_yam.face.datasets.repair.inspection import inspect
from lerobot_robot_yam.rig.lockstep.demonstrator import Demonstrator
from lerobot_robot_yam.system.paths import write_whole
from lerobot_robot_yam.system.signals import finished_first
from lerobot_robot_yam.yam_env import YamEnv

logger = logging.getLogger(__name__)

_SEEDS = "seeds.json"  # file in the data set's directory: seed -> whether the attempt with that seed succeeded
_GIVE_UP = 20  # consecutive failures after which gathering stops
_ENCODER = {"vcodec": "h264", "preset": "ultrafast", "crf": 18}


class Frame(NamedTuple):
    """One step: observation before the step, action (m,) as sent to the robot, and whether the task has succeeded."""

    observation: dict[str, Any]
    action: np.ndarray
    success: bool


def demonstrate(env: YamEnv, seed: int) -> Iterator[Frame]:
    """Yield the steps of the scripted operator's attempt at the task; `seed` determines the layout of the scene.

    Raises:
        ConfigError: the environment is not in lock-step, or its task has no scripted operator.
        YamError: the robot, the rig or the operator fails.
    """
    observation, _ = env.reset(seed=seed)
    rig, task = env.lockstep_task()
    operator = Demonstrator(rig, task, env.sides)
    try:
        over = False
        while not over:
            targets = operator.targets()
            joints = np.concatenate([targets[side] for side in env.sides])
            action = env.action_of(joints, operator.velocity)
            before = observation
            observation, _, terminated, truncated, info = env.step(action)
            over = terminated or truncated
            yield Frame(before, env.sent, bool(info["is_success"]))
    finally:
        operator.close()


def features_of(config: YamEnvConfig) -> dict[str, dict[str, Any]]:
    """Return the data set's features, identical to those that `lerobot-record` writes for the environment's robot."""
    robot = cast(Any, config.robot)
    features: dict[str, dict[str, Any]] = {}
    for key, names in ((ACTION, robot.action_keys()), (OBS_STATE, robot.state_keys())):
        features[key] = {"dtype": "float32", "shape": (len(names),), "names": names}
    for name, camera in eyes_of(robot).items():
        shape = (camera.height, camera.width, 3)
        features[f"{OBS_IMAGES}.{name}"] = {"dtype": "video", "shape": shape, "names": ["height", "width", "channels"]}
    return features


def gather(config: YamEnvConfig, root: Path, repo_id: str, episodes: int, first_seed: int) -> dict[int, bool]:
    """Gather until the data set in `root` has `episodes` episodes; return seed -> success for all seeds tried.

    Raises:
        RigError: the operator failed `_GIVE_UP` times in a row.
        YamError: the environment fails.
    """
    seeds_path = root / _SEEDS
    tried = {int(seed): won for seed, won in json.loads(seeds_path.read_text()).items()} if seeds_path.exists() else {}
    env = YamEnv(config)
    dataset: LeRobotDataset | None = None
    failures = 0
    try:
        env.reset(seed=first_seed)  # before `_open`: if the environment cannot start, no data set is left behind
        dataset = _open(config, root, repo_id, env._max_episode_steps)
        with tqdm(total=episodes, initial=dataset.num_episodes, unit="episode") as bar:
            while dataset.num_episodes < episodes:
                seed = max(tried, default=first_seed - 1) + 1
                won = _attempt(env, seed, dataset)
                tried[seed] = won
                with finished_first("saving the episode"):
                    write_whole(seeds_path, json.dumps(tried))  # before saving: no later run may repeat the seed
                    if won:
                        dataset.save_episode()
                        bar.update()
                    else:
                        dataset.clear_episode_buffer()
                        logger.info("seed %d: the operator failed; dropped", seed)
                failures = 0 if won else failures + 1
                if failures >= _GIVE_UP:
                    raise RigError(f"the operator failed {failures} times in a row; does the scene suit its script?")
    finally:
        env.close()
        if dataset is not None:
            dataset.finalize()
    return tried


def _attempt(env: YamEnv, seed: int, dataset: LeRobotDataset) -> bool:
    success = False
    for seen, action, success in demonstrate(env, seed):  # noqa: B007
        images = {f"{OBS_IMAGES}.{name}": image for name, image in seen["pixels"].items()}
        row = {OBS_STATE: seen[AGENT_POS], ACTION: action.astype(np.float32), **images, "task": env.task_description}
        dataset.add_frame(row)
    return success


def _open(config: YamEnvConfig, root: Path, repo_id: str, steps: int) -> LeRobotDataset:
    encoding: dict[str, Any] = {"rgb_encoder": RGBEncoderConfig(**_ENCODER), "streaming_encoding": True}
    encoding |= {"encoder_threads": 1, "encoder_queue_maxsize": steps + 1}  # LeRobot drops frames beyond the queue
    robot, features = cast(Any, config.robot), features_of(config)
    robot_type = recorded_name(robot.type, robot.use_degrees, robot.action_space)
    if not (root / "meta" / "info.json").exists():
        return LeRobotDataset.create(repo_id, config.fps, features, root, robot_type=robot_type, **encoding)
    if wrong := damage(root):  # LeRobot would count an interrupted episode's rows twice and shift all others
        raise ConfigError(
            f"{root}: gathering was killed ({wrong}); run `yam-repair-dataset {root}` and put the repaired copy in its "
            "place to go on"
        )
    dataset = LeRobotDataset.resume(repo_id, root, **encoding)
    _refuse_another("fps", dataset.fps, config.fps, root)
    _refuse_another("robot", dataset.meta.robot_type, robot_type, root)
    recorded = [key for key in dataset.features if key in (ACTION, OBS_STATE) or key.startswith(OBS_IMAGES)]
    _refuse_another("features", sorted(recorded), sorted(features), root)
    for key, wanted in features.items():
        held = dataset.features[key]
        for part in ("names", "shape"):
            _refuse_another(f"{key} {part}", list(held[part] or ()), list(wanted[part]), root)
    return dataset


def damage(root: Path) -> str:
    """Return the first defect that a killed run left in the data set in `root`; empty if the data set is intact."""
    if not any((root / "data").glob("*/*.parquet")):
        return ""
    findings = inspect(root, lambda episodes: ())  # without decoding the videos
    wrong = [*findings.problems, *(f"episode {e.number}: {e.lost}" for e in findings.episodes if e.lost)]
    return wrong[0] if wrong else ""


def _refuse_another(what: str, held: object, wanted: object, root: Path) -> None:
    if held != wanted:
        raise ConfigError(f"{root}: its {what} is {held}, that of the environment {wanted}; give another --root")


def environment(path: Path) -> YamEnvConfig:
    """Return the environment config from the `lerobot-eval` config at `path`.

    Raises:
        ConfigError: the config cannot be read, or its environment is not of type yam, or not in lock-step.
    """
    try:
        config = draccus.parse(EvalPipelineConfig, path, args=[]).env
    except (OSError, DecodingError, ParsingError, AttributeError) as error:  # AttributeError: the file is not a mapping
        raise ConfigError(f"{path} is no config of lerobot-eval: {error.__cause__ or error}") from error
    if not isinstance(config, YamEnvConfig) or not config.lockstep:
        raise ConfigError(f"{path}: yam-gather needs an environment of type yam with lockstep: true")
    return config
