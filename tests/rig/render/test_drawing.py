import numpy as np

from lerobot_robot_yam.rig.render.drawing import Sensor


def test_every_exposure_of_a_still_scene_differs_a_little():
    sensor = Sensor(64, 48, sigma=2.0)
    clean = np.full((48, 64, 3), 100, np.uint8)
    first, second = np.empty_like(clean), np.empty_like(clean)
    sensor.expose(clean, first)
    sensor.expose(clean, second)
    assert not np.array_equal(first, second)
    assert 1.5 < first.std() < 2.5 and abs(first.mean() - 100) < 0.5


def test_black_and_white_do_not_wrap_round():
    sensor = Sensor(64, 48, sigma=5.0)
    out = np.empty((48, 64, 3), np.uint8)
    sensor.expose(np.zeros((48, 64, 3), np.uint8), out)
    assert out.max() < 50
    sensor.expose(np.full((48, 64, 3), 255, np.uint8), out)
    assert out.min() > 200
