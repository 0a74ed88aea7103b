"""lerobot-record and lerobot-replay over the link: the arms are another machine's, with its own runtime directory."""

import numpy as np
import pytest
from lerobot.datasets import LeRobotDataset

from tests.cli.conftest import one_episode, options
from tests.cli.test_record import BI_KEYS
from tests.cli.test_rollout import INFERENCES, correct, records
from tests.support.hosted import rig_file, running_host
from tests.support.rolling import Rollout, config, data_set

pytestmark = [pytest.mark.alone, pytest.mark.long]

SECONDS = 8


@pytest.fixture(scope="module", params=[{}, {"gate": "always"}], ids=["at LeRobot's rate", "coupled"])
def recorded(request, shared_commands, tmp_path_factory):
    commands, directory = shared_commands, tmp_path_factory.mktemp("link")
    workstation = directory / "ws"
    workstation.mkdir(mode=0o700)
    with running_host(rig_file(directory, commands.rig, **request.param), directory) as host:
        with pytest.MonkeyPatch.context() as monkeypatch:
            monkeypatch.setenv("YAM_RUNTIME_DIR", str(workstation))
            status = commands.run(
                "lerobot-record",
                *options(
                    robot={"type": "bi_yam_remote", "host": host.address},
                    teleop={"type": "bi_yam_remote_leader", "host": host.address},
                    dataset=one_episode("link", directory / "data", SECONDS),
                ),
                "--play_sounds=false",
            )
            assert status == 0, commands.output()[-4000:] + host.said()
            assert not list(workstation.iterdir())
            yield commands, LeRobotDataset("local/link", root=directory / "data"), host


def test_arms_follow_the_leaders(recorded):
    _, data, host = recorded
    assert data.meta.robot_type == "bi_yam_follower" and list(data.features["action"]["names"]) == BI_KEYS
    table = data.hf_dataset.with_format("numpy")
    state, action = np.stack(table["observation.state"]), np.stack(table["action"])
    assert len(state) > 0.8 * SECONDS * data.fps
    assert np.isfinite(state).all() and (np.ptp(action, axis=0)[[0, 1, 2]] > 0.1).any(), host.said()
    joints = [*range(6), *range(7, 13)]
    lag = np.abs(state[32:, joints] - action[30:-2, joints])
    assert np.median(lag) < 0.03 and lag.max() < 0.3


def test_replay_over_the_link_and_all_arms_land(recorded):
    commands, data, host = recorded
    commands.assert_landed()
    status = commands.run(
        "lerobot-replay",
        *options(
            robot={"type": "bi_yam_remote", "host": host.address},
            dataset={"repo_id": data.repo_id, "root": data.root, "episode": 0},
        ),
        "--play_sounds=false",
    )
    assert status == 0, commands.output()[-4000:]
    commands.assert_landed()


@pytest.fixture
def rollout(commands):
    rollout = Rollout(commands)
    yield rollout
    rollout.abandon()


@pytest.mark.parametrize("strategy, inference", [("base", "sync"), ("base", "rtc"), ("dagger", "sync")])
def test_a_policy_drives_the_arms_over_the_link(rollout, tmp_path, monkeypatch, strategy, inference):
    workstation = tmp_path / "ws"
    workstation.mkdir(mode=0o700)
    document = config("dagger" if strategy == "dagger" else "rollout", inference=INFERENCES[inference])
    document["strategy"] = {"type": strategy}
    with running_host(rig_file(tmp_path, rollout.rig), tmp_path) as host:
        monkeypatch.setenv("YAM_RUNTIME_DIR", str(workstation))
        document["robot"] = {"type": "bi_yam_remote", "host": str(host.address)}
        if strategy == "dagger":
            document["teleop"] = {"type": "bi_yam_remote_leader", "host": str(host.address)}
            document["dataset"] = data_set(rollout.root, num_episodes=2, episode_time_s=3, reset_time_s=1)
        else:
            document["duration"] = SECONDS
        rollout.begin(document, "sines", amplitude=0.3)
        if strategy == "dagger":
            rollout.wait_moved(0.15)
            correct(rollout, 1)
            rollout.wait_said("Resuming autonomous mode")
            rollout.watch(1.5)
            correct(rollout, 2)
        assert rollout.end() == 0, rollout.commands.output()[-4000:] + host.said()
        rollout.assert_moved(0.15)
        rollout.assert_ended_well()
        assert not list(workstation.iterdir())
    if strategy == "dagger":
        assert list(records(rollout.root, 2).features["action"]["names"]) == BI_KEYS
