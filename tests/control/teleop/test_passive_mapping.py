"""From encoders to the follower's joints, with zeros, ranges and the trigger's travel."""

import json

import numpy as np
import pytest

from lerobot_robot_yam.arm.leaders.passive_config import JOINT_SIGNS, PassiveConfig
from lerobot_robot_yam.control.teleop.passive_mapping import PassiveCalibration, PassiveMapping
from lerobot_robot_yam.errors import ConfigError

LIMITS = np.array([[-2.0, 2.0]] * 6)
SIGNS = JOINT_SIGNS["desk"]
SMALL = [[-1.0, 1.0]] * 6


def mapping(**fields):
    return PassiveMapping("leader", PassiveConfig(joint_sign=SIGNS, **fields), LIMITS)


def stored(path, zero=0.1, trigger=-0.5, ranges=SMALL):
    PassiveCalibration([zero] * 6, ranges, trigger).save("leader", path)
    return str(path)


def test_signs_and_nothing_else_without_a_calibration():
    q, dq = mapping().joints(np.full(6, 0.5), np.full(6, 1.0))
    np.testing.assert_allclose(q, 0.5 * np.array(SIGNS))
    np.testing.assert_allclose(dq, SIGNS)


def test_stored_zeros_count_and_the_trigger_has_its_own_travel(tmp_path):
    found = mapping(calibration_path=stored(tmp_path / "a.json"))
    np.testing.assert_allclose(found.joints(0.1 * np.array(SIGNS), np.zeros(6))[0], 0.0, atol=1e-12)
    assert [found.trigger(angle) for angle in (0.0, 0.25, -0.25, -0.6)] == [0.0, 0.5, 0.5, 1.0]
    assert mapping().trigger(0.67) == 1.0


def test_a_range_is_stretched_onto_the_followers():
    found = mapping(mapping="range", leader_range_rad=[[-0.5, 1.5]] * 6)
    for own, follower in ((-0.5, -2.0), (1.5, 2.0), (0.5, 0.0)):
        np.testing.assert_allclose(found.joints(own * np.array(SIGNS), np.zeros(6))[0], follower, atol=1e-12)
    np.testing.assert_allclose(found.joints(np.zeros(6), np.array(SIGNS))[1], 2.0)


def test_calibrated_ranges_serve_when_none_are_given(tmp_path):
    found = mapping(mapping="range", calibration_path=stored(tmp_path / "a.json", zero=0.0))
    np.testing.assert_allclose(found.joints(0.5 * np.array(SIGNS), np.zeros(6))[0], 1.0)
    with pytest.raises(ConfigError, match="needs the leader's ranges; calibrate it"):
        mapping(mapping="range")


@pytest.mark.parametrize(
    "change",
    [
        {"version": 2},
        {"zero_rad": [0.0] * 5},
        {"zero_rad": [float("nan")] * 6},
        {"range_rad": [[0.0, 0.0]] * 6},
        {"trigger_rad": "far"},
    ],
)
def test_a_damaged_calibration_is_refused(tmp_path, change):
    path = tmp_path / "a.json"
    stored(path)
    path.write_text(json.dumps(json.loads(path.read_text()) | change))
    with pytest.raises(ConfigError, match=r"a\.json is no calibration of a passive leader with 6 joints"):
        mapping(calibration_path=str(path))


@pytest.mark.parametrize(
    ("trigger", "ranges", "message"), [(0.0, SMALL, "squeezed"), (0.6, [[0, 0.1]] * 6, "0.2 apart")]
)
def test_a_calibration_without_motion_is_refused(trigger, ranges, message):
    with pytest.raises(ConfigError, match=message):
        PassiveCalibration([0.0] * 6, ranges, trigger).check("leader")
