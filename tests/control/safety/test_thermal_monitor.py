"""Heat: stages, hysteresis, and what is no temperature."""

import logging

import numpy as np
import pytest

from lerobot_robot_yam.control.safety.thermal_monitor import Stage, ThermalMonitor, trips_c
from scripts.recorders import stamped_bytes
from tests.support.tiers import spread

TICK_S = 0.004
NAMES = ["joint_1", "joint_2", "gripper"]
COOL = 40.0


class Desk:
    """A watch of three motors whose power stages trip at 120 °C, coils at 80 °C."""

    def __init__(self):
        self.watch = ThermalMonitor("left", np.full(3, 120.0), np.full(3, 80.0), NAMES)
        self.now = 1000.0

    def go_on(self, seconds, mos=(COOL,) * 3, rotor=(COOL,) * 3):
        heat = None
        for _ in range(max(1, round(seconds / TICK_S))):
            self.now += TICK_S
            heat = self.watch.check(self.now, np.array(mos), np.array(rotor))
        return heat

    def coil(self, temperature, seconds=1.0):
        """The second motor's coil."""
        return self.go_on(seconds, rotor=(COOL, temperature, COOL))


def test_stages_levels_and_speed_follow_the_warmest_sensor():
    desk = Desk()
    seen = []
    for temperature in (40.0, 64.0, 65.0, 70.0, 75.0, 80.0, 90.0):
        heat = desk.coil(temperature)
        seen.append((int(heat.stage), round(float(heat.level[1]), 3), heat.speed_scale))
    assert seen == [
        (Stage.NONE, 0.0, 1.0),
        (Stage.NONE, 0.0, 1.0),
        (Stage.WARM, 0.0, 0.5),
        (Stage.WARM, 0.333, 0.5),
        (Stage.HOT, 0.667, 0.5),
        (Stage.HOT, 1.0, 0.5),
        (Stage.HOT, 1.0, 0.5),
    ]
    assert heat.stages.tolist() == [0, 2, 0] and heat.level[0] == heat.level[2] == 0.0
    assert "joint_2: power stage 40 °C (trips at 120), coil 90 °C (trips at 80)" == heat.message
    desk = Desk()
    assert desk.go_on(1.0, mos=(COOL, COOL, 114.0)).stage is Stage.WARM
    assert desk.go_on(1.0, mos=(COOL, COOL, 115.0)).stage is Stage.HOT


def test_a_stage_ends_three_degrees_lower_and_each_stretch_is_said_once(caplog):
    caplog.set_level(logging.INFO)
    desk = Desk()
    stages = [int(desk.coil(t).stage) for t in (65, 64, 66, 62, 65, 61.9, 75, 73, 72, 71.9, 61)]
    assert stages == [1, 1, 1, 1, 1, 0, 2, 2, 2, 1, 0]
    warnings = [r.getMessage() for r in caplog.records if r.levelno == logging.WARNING]
    assert len(warnings) == 2
    assert all("left" in w and "joint_2" in w and "40 °C" in w and "coil" in w for w in warnings)
    assert sum(r.levelno == logging.ERROR for r in caplog.records) == 1


def test_a_jump_counts_after_half_a_second_of_it_and_not_before():
    desk = Desk()
    desk.coil(COOL)
    assert desk.coil(78.0, seconds=0.48).stage is Stage.NONE
    assert desk.coil(78.0, seconds=0.06).stage is Stage.HOT
    spikes = Desk()
    spikes.coil(COOL)
    for _ in range(20):
        assert spikes.coil(255.0, seconds=0.4).stage is Stage.NONE
        assert spikes.coil(COOL, seconds=0.02).stage is Stage.NONE
        assert spikes.coil(0.0, seconds=0.2).stage is Stage.NONE


def test_a_motor_heating_up_is_noticed_at_once():
    desk = Desk()
    desk.coil(COOL)
    reached = None
    for tick in range(2500):  # 5 °C/s: faster than any coil, in whole degrees
        heat = desk.coil(float(int(COOL + 5.0 * tick * TICK_S)), seconds=TICK_S)
        if heat.stage is Stage.HOT:
            reached = COOL + 5.0 * tick * TICK_S
            break
    assert reached == pytest.approx(75.0, abs=0.1)


@pytest.mark.parametrize("period_s", spread([TICK_S, 0.1, 84 * 2e-4, 6 * 84 * 2e-4, 84**2 * 2e-4], 1, 3, 4))
@pytest.mark.parametrize("jitter", spread([0.0, 0.0003, 0.2], 1))
def test_stamps_in_place_of_temperatures_are_no_heat(period_s, jitter):
    """As `stamp_temperatures` sends them; at some rates of reading they stand still."""
    desk = Desk()
    desk.watch = ThermalMonitor("left", *trips_c([100.0] * 3), NAMES)
    chance = np.random.default_rng(3)
    for _ in range(5000):
        desk.now += period_s * chance.uniform(1.0 - jitter, 1.0 + jitter)
        mos, rotor = stamped_bytes(desk.now)
        heat = desk.watch.check(desk.now, np.full(3, float(mos)), np.full(3, float(rotor)))
        assert heat.stage is Stage.NONE


def test_before_the_first_answer_nothing_is_known():
    desk = Desk()
    heat = desk.go_on(2.0, mos=(np.nan,) * 3, rotor=(np.nan,) * 3)
    assert heat.stage is Stage.NONE and not heat.level.any() and heat.speed_scale == 1.0 and heat.message == ""
    assert desk.coil(78.0, seconds=0.4).stage is Stage.NONE
    assert desk.coil(78.0, seconds=0.2).stage is Stage.HOT
    one = Desk()
    assert one.go_on(1.0, mos=(np.nan, COOL, COOL), rotor=(78.0, COOL, COOL)).stages.tolist() == [2, 0, 0]


def test_trips_come_from_the_register_within_reason():
    mos, coil = trips_c([80.0, 100.0, 110.0, 150.0, 0.0, 255.0, float("nan")])
    assert mos.tolist() == [80.0, 100.0, 110.0, 120.0, 80.0, 80.0, 80.0]
    assert coil.tolist() == [80.0, 100.0, 100.0, 100.0, 80.0, 80.0, 80.0]
