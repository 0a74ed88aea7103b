import numpy as np

from lerobot_robot_yam.damiao.codec import decode_mit, encode_mit
from lerobot_robot_yam.damiao.quantisation import Quantiser

TYPES = ["DM4340", "DM4310", "DM3507"]


def torque_at(rows, q):
    """What motors that stand still at q (n,) make of the packed commands, Nm, with the gains really sent."""
    sent = [decode_mit(kind, encode_mit(kind, *row)) for kind, row in zip(TYPES, rows.tolist(), strict=True)]
    return np.array([c.kp * (c.position - at) + c.kd * c.velocity + c.torque for c, at in zip(sent, q, strict=True)])


def test_the_motors_torque_comes_closer_to_the_wanted_one():
    rng = np.random.default_rng(0)
    quantiser = Quantiser(TYPES)
    plain, better = [], []
    for _ in range(300):
        rows = np.column_stack(
            (rng.uniform(-3, 3, 3), np.zeros(3), [80.0, 10.0, 10.0], [5.0, 1.5, 0.3], rng.uniform(-2, 2, 3))
        )
        wanted = rows[:, 3] * rows[:, 1] + rows[:, 4]  # standing at the set-point
        plain.append(torque_at(rows, rows[:, 0]) - wanted)
        better.append(torque_at(quantiser.compensate(rows), rows[:, 0]) - wanted)
    assert np.abs(np.mean(plain, axis=0)).max() > 0.01  # truncation is a bias, not noise
    assert np.abs(np.mean(better, axis=0)).max() < 0.002
    steps = np.array([2 * 28.0, 2 * 10.0, 2 * 5.0]) / 4095
    assert (np.abs(better).max(axis=0) < 0.75 * steps).all()


def test_commands_are_copied():
    rows = np.zeros((3, 5))
    assert Quantiser(TYPES).compensate(rows) is not rows
    assert not rows.any()
