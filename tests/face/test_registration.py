"""Our types are in LeRobot's registries whenever LeRobot looks, and cost nothing when it does not.

LeRobot's tracebacks about FFmpeg are one line where FFmpeg is not installed, and whole where something else is wrong.
"""

import importlib
import logging
import subprocess
import sys
import textwrap
from pathlib import Path

import lerobot.robots.config  # noqa: F401  which makes it register
import pytest
from lerobot.utils.import_utils import get_safe_default_video_backend

import lerobot_robot_yam  # noqa: F401
from tests.support.paths import ROOT

TYPES = {
    "lerobot.robots": (
        "RobotConfig",
        ["yam_follower", "bi_yam_follower", "i2rt_yam_follower", "bi_i2rt_yam_follower"],
    ),
    "lerobot.teleoperators": (
        "TeleoperatorConfig",
        ["yam_leader", "bi_yam_leader", "i2rt_yam_leader", "bi_i2rt_yam_leader"],
    ),
    "lerobot.cameras": ("CameraConfig", ["yam_sim"]),
    "lerobot.envs": ("EnvConfig", ["yam"]),
    "lerobot.configs": ("PreTrainedConfig", ["yam_openpi"]),
    "lerobot.rollout": ("RolloutStrategyConfig", ["yam_dagger"]),
}
MISSING = "OSError: libavutil.so.{}: cannot open shared object file: No such file or directory"
BROKEN = "OSError: libtorchcodec_core7.so: undefined symbol: _ZNK3c105Error4whatEv"
OUTER = "The above exception was the direct cause of the following exception:\nOSError: Could not load this library: x"
CHECK = f"""
import importlib
for module, (registry, types) in {TYPES}.items():
    known = getattr(importlib.import_module(module), registry).get_known_choices()
    assert all(name in known for name in types), (module, list(known))
"""


def run(program):
    """Run a program in an interpreter of its own; returns what it printed."""
    done = subprocess.run([sys.executable, "-c", textwrap.dedent(program)], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.parametrize(
    "module", ["lerobot_robot_yam", "lerobot_teleoperator_yam", "lerobot_robot_yam.session.arm_session"]
)
def test_importing_us_alone_loads_neither_lerobot_nor_torch(module):
    loaded = run(f"import {module}, sys; print([m for m in sys.modules if m.split('.')[0] in ('lerobot', 'torch')])")
    assert loaded.strip() == "[]"


@pytest.mark.parametrize(
    "first",
    [
        pytest.param("import lerobot_robot_yam", marks=pytest.mark.long),  # by default: the test after this one
        "import lerobot_teleoperator_yam",
        pytest.param("import lerobot.robots; import lerobot_robot_yam", marks=pytest.mark.long),
        pytest.param("import lerobot.cameras; import lerobot_robot_yam", marks=pytest.mark.long),
        pytest.param("import lerobot.configs; import lerobot_robot_yam", marks=pytest.mark.long),
        pytest.param("import lerobot_robot_yam.config_yam_follower", marks=pytest.mark.long),
        pytest.param("import lerobot_robot_yam.config_yam_camera", marks=pytest.mark.long),
        pytest.param("import lerobot_robot_yam.config_yam_env", marks=pytest.mark.long),
        pytest.param("import lerobot_robot_yam.face.openpi.configuration_openpi", marks=pytest.mark.long),
        pytest.param("import lerobot_teleoperator_yam.config_yam_leader", marks=pytest.mark.long),
        pytest.param("from lerobot_robot_yam import BiYamFollower", marks=pytest.mark.long),
        pytest.param("from lerobot_teleoperator_yam import BiYamLeader", marks=pytest.mark.long),
        pytest.param(
            "import lerobot.scripts.lerobot_calibrate as c; c.register_third_party_plugins()", marks=pytest.mark.long
        ),
    ],
)
def test_types_are_registered_whoever_comes_first(first):
    run(f"{first}\n{CHECK}")


def test_types_are_registered_and_no_import_hook_is_left():
    print_hooks = "import sys; print([f for f in sys.meta_path if type(f).__module__.startswith('lerobot_robot_yam')])"
    assert run(f"import lerobot_robot_yam\n{CHECK}\n{print_hooks}").strip() == "[]"


def test_registering_loads_nothing_heavy():
    """Neither foreign modules nor, of ours, the profiles, which take 40 ms."""
    loaded = run(
        """
        import sys
        import lerobot.robots, lerobot.teleoperators, lerobot.cameras, lerobot.configs
        before = set(sys.modules)
        import lerobot_robot_yam
        loaded = set(sys.modules) - before
        print(sorted(name for name in loaded if not name.startswith("lerobot_") or "profile" in name))
        """
    )
    assert loaded.strip() == "[]"


@pytest.mark.parametrize(
    "package, names",
    [
        ("lerobot_robot_yam", ["YamFollower", "BiYamFollower", "YamSimCamera", "YamArm"]),
        ("lerobot_teleoperator_yam", ["YamLeader", "BiYamLeader"]),
        ("lerobot_strategy_yam", ["YamDaggerStrategy", "YamDaggerStrategyConfig"]),
    ],
)
def test_public_names_load_on_first_use(package, names):
    """LeRobot's factory looks for device classes in the package, and swallows import errors of their modules."""
    module = importlib.import_module(package)
    for name in names:
        assert getattr(module, name).__name__ == name
        assert name in module.__all__
    with pytest.raises(AttributeError, match="has no attribute 'Nothing'"):
        module.Nothing  # noqa: B018


def torchcodec_error(*causes):
    """What torchcodec raises when every attempt to load it has failed."""
    attempts = [f"FFmpeg version {8 - n}:\nTraceback …\n{cause}\n\n{OUTER}\n" for n, cause in enumerate(causes)]
    inner = "\n".join(attempts)
    return (
        "Could not load libtorchcodec. Likely causes: 1. FFmpeg is not properly installed …\n"
        f"[start of libtorchcodec loading traceback]\n{inner}[end of libtorchcodec loading traceback]."
    )


@pytest.fixture
def attempt(monkeypatch, caplog):
    """Lets LeRobot choose how to read videos, with a torchcodec that cannot be loaded; returns what it logs."""
    for one in logging.getLogger("lerobot.utils.import_utils").filters:
        monkeypatch.setattr(one, "told", False)

    def choose(error):
        def fail(name):
            raise RuntimeError(error)

        monkeypatch.setattr("lerobot.utils.import_utils.importlib.import_module", fail)
        caplog.clear()
        with caplog.at_level(logging.INFO):
            assert get_safe_default_video_backend() == "pyav"
        monkeypatch.undo()
        return [record.getMessage() for record in caplog.records]

    return choose


def test_ffmpeg_that_is_not_there_is_one_line_once(attempt):
    error = torchcodec_error(*(MISSING.format(n) for n in (60, 59, 58, 57, 56)))
    (line,) = attempt(error)
    assert "PyAV" in line and "\n" not in line


@pytest.mark.parametrize(
    "error",
    [
        torchcodec_error(MISSING.format(60), BROKEN, MISSING.format(58)),
        torchcodec_error(BROKEN),
        "libtorch.so is gone",
        "Could not load libtorchcodec for a reason of its own",
    ],
)
def test_any_other_reason_is_shown_in_full(attempt, error):
    (text,) = attempt(error)
    assert error in text


@pytest.mark.long
def test_a_command_shows_its_real_error_and_no_page_about_ffmpeg(tmp_path):
    """Replaying what is not there, before anything is energised."""
    command = [Path(sys.executable).parent / "lerobot-replay", f"--config_path={ROOT / 'configs/sim/replay.yaml'}"]
    options = ["--dataset.repo_id=local/nothing", f"--dataset.root={tmp_path / 'nothing'}", "--dataset.episode=0"]
    done = subprocess.run([*command, *options], capture_output=True, text=True, timeout=200)
    assert done.returncode != 0 and done.stderr.strip().splitlines()[-1].startswith("error: there is no data set in ")
    assert "libtorchcodec" not in done.stderr and done.stderr.count("FFmpeg") <= 1
