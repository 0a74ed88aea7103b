"""Our types are in LeRobot's registries whenever LeRobot looks, and cost nothing when it does not."""

import importlib
import subprocess
import sys
import textwrap

import pytest

TYPES = {
    "lerobot.robots": (
        "RobotConfig",
        ["yam_follower", "bi_yam_follower", "yam_base", "yam_mobile", "i2rt_yam_follower", "bi_i2rt_yam_follower"],
    ),
    "lerobot.teleoperators": (
        "TeleoperatorConfig",
        [
            "yam_leader",
            "bi_yam_leader",
            "i2rt_yam_leader",
            "bi_i2rt_yam_leader",
            "yam_gamepad",
            "yam_base_keys",
            "yam_mobile_leader",
        ],
    ),
    "lerobot.cameras": ("CameraConfig", ["yam_sim"]),
    "lerobot.envs": ("EnvConfig", ["yam"]),
    "lerobot.configs": ("PreTrainedConfig", ["yam_openpi"]),
    "lerobot.rollout": ("RolloutStrategyConfig", ["yam_dagger"]),
}
CHECK = f"""
import importlib, sys
for module, (registry, types) in {TYPES}.items():
    known = getattr(importlib.import_module(module), registry).get_known_choices()
    assert all(name in known for name in types), (module, list(known))
"""


def run(program):
    """Run a program in an interpreter of its own; returns what it printed."""
    done = subprocess.run([sys.executable, "-c", textwrap.dedent(program)], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_importing_us_alone_loads_neither_lerobot_nor_torch():
    imports = "import lerobot_robot_yam, lerobot_teleoperator_yam, lerobot_robot_yam.session.arm_session, sys"
    loaded = run(f"{imports}; print([m for m in sys.modules if m.split('.')[0] in ('lerobot', 'torch')])")
    assert loaded.strip() == "[]"


FIRST = [
    "import lerobot_robot_yam",
    "import lerobot_teleoperator_yam",
    "import lerobot.robots; import lerobot_robot_yam",
    "import lerobot.cameras; import lerobot_robot_yam",
    "import lerobot.configs; import lerobot_robot_yam",
    "import lerobot_robot_yam.config_yam_follower",
    "import lerobot_robot_yam.config_yam_camera",
    "import lerobot_robot_yam.config_yam_env",
    "import lerobot_robot_yam.face.openpi.configuration_openpi",
    "import lerobot_robot_yam.config_yam_mobile",
    "import lerobot_teleoperator_yam.config_yam_leader",
    "import lerobot_teleoperator_yam.config_yam_gamepad",
    "import lerobot_teleoperator_yam.config_yam_mobile_leader",
    "from lerobot_robot_yam import BiYamFollower",
    "from lerobot_teleoperator_yam import BiYamLeader",
    "import lerobot.scripts.lerobot_calibrate as c; c.register_third_party_plugins()",
]


QUICK = ("import lerobot_robot_yam.config_yam_follower",)
FIRST_MARKED = [pytest.param(first, marks=[] if first in QUICK else [pytest.mark.long]) for first in FIRST]


@pytest.mark.parametrize("first", FIRST_MARKED)
def test_types_are_registered_whoever_comes_first(first):
    run(f"{first}\n{CHECK}")


def test_types_are_registered_now_or_by_a_hook_and_that_loads_nothing_heavy():
    """Neither foreign modules nor, of ours, the profiles, which take 40 ms. The hook is for what is loaded later."""
    program = f"""
import sys
import lerobot.robots, lerobot.teleoperators, lerobot.cameras, lerobot.configs
before = set(sys.modules)
import lerobot_robot_yam
loaded = set(sys.modules) - before
print(sorted(name for name in loaded if not name.startswith(("lerobot_", "wrapt")) or "arm.profile" in name))
assert not {{"lerobot.envs", "lerobot.rollout"}} & loaded
{CHECK}
"""
    assert run(program).strip() == "[]"


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
