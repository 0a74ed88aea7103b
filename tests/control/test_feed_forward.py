"""What is fed forward, from the configuration to where the arm hangs: by the rig's truth, without the hold integral."""

import numpy as np
import pytest

from lerobot_robot_yam.arm.resolved_arm import ResolvedArm
from lerobot_robot_yam.control.impedance import gravity_model
from scripts import recorders
from tests.support.rigged import arm_that_stays_up, rig_of, session_on, sim_config, track
from tests.support.tiers import spread

CHANNEL = "follower_left"
POSE = np.array([0.3, 1.3, 1.1, -0.4, 0.2, 0.1])
NEAR_RAD = 0.003
INERTIA = [0.0, 0.0, 0.1, 1.0, 0.0, 0.0, 0.0, 1e-3, 1e-3, 1e-3]  # the centre of the end effector lies elsewhere


def sag(**fields):
    """(6,) rad, by how much an arm of that configuration hangs lower than asked; and the configuration's hardware."""
    with rig_of("lockstep", arms=[CHANNEL], friction=0.0) as rig:
        fields["hold_integral"] = False
        with arm_that_stays_up(rig, CHANNEL, **fields) as arm:
            arm.move_to(POSE, speed_rad_s=1.3)
            arm.clock.sleep(1.5)
            true = np.array(rig.state()["arms"][CHANNEL]["q"][:6])
        return POSE - true, ResolvedArm(sim_config(rig, CHANNEL, **fields))


@pytest.mark.long
def test_the_model_alone_holds_the_arm():
    hanging, _ = sag()
    assert np.abs(hanging).max() <= NEAR_RAD


@pytest.mark.parametrize("joint", spread([1, 2, 3], 1))
def test_each_joint_has_its_factor_of_gravity(joint):
    factors = [1.0] * 6
    factors[joint] = 0.8
    hanging, hardware = sag(gravity_factor=factors)
    true = POSE - hanging
    expected = np.zeros(6)
    expected[joint] = 0.2 * gravity_model(hardware).torque(true)[joint] / hardware.kp[joint]
    assert abs(expected[joint]) > 2 * NEAR_RAD and hanging == pytest.approx(expected, abs=NEAR_RAD)


@pytest.mark.parametrize(
    "fields", spread([{"payload_mass_kg": 0.5, "payload_com_m": [0.0, 0.0, 0.02]}, {"ee_inertia": INERTIA}], 0)
)
def test_a_load_that_is_configured_is_carried(fields):
    """Here there is none: the arm is lifted by what the load would weigh."""
    hanging, hardware = sag(**fields)
    _, bare = sag()
    true = POSE - hanging
    torque = gravity_model(bare).torque(true) - gravity_model(hardware).torque(true)
    expected = torque / hardware.kp[:6]
    assert np.abs(expected).max() > 2 * NEAR_RAD and hanging == pytest.approx(expected, abs=NEAR_RAD)


@pytest.mark.long
def test_coulomb_friction_that_is_fed_forward_is_made_up_for():
    """A slow sweep, which friction holds back most."""
    lags = {}
    for known in (False, True):
        with rig_of("lockstep", arms=[CHANNEL]) as rig:
            config = sim_config(rig, CHANNEL)
            friction = ResolvedArm(config).arm.friction_nm.tolist() if known else None
            with arm_that_stays_up(rig, CHANNEL, hold_integral=False, coulomb_friction_nm=friction) as arm:
                arm.move_to(POSE)
                begin, errors = arm.clock.now(), []
                while (t := arm.clock.now() - begin) < 6.0:
                    arm.command(POSE + 0.15 * np.sin(np.pi * t / 2))
                    state = arm.observe()
                    if t > 1.0:
                        errors.append(state.q - state.setpoint_q)
                    arm.clock.sleep(1 / 60)
        lags[known] = np.sqrt(np.mean(np.square(errors), axis=0))
    assert lags[True].max() < 0.7 * lags[False].max(), lags


@pytest.mark.long
def test_what_starts_quickly_is_hardly_quicker_than_its_set_point():
    """All joints at once, so that each throws the others about; what is fed forward holds them to their ways."""
    with rig_of("lockstep", arms=[CHANNEL]) as rig:
        session = session_on(rig, sim_config(rig, CHANNEL))
        session.start()
        track(session, {CHANNEL: [0.0, 0.3, 1.2, 0.2, 0.0, 0.0]}, 1.5)
        track(session, {CHANNEL: [0.0, 0.6, 1.2, 0.0, 0.0, 0.0]}, 1.2)
        session.clock.sleep(0.7)
        recorders.watch_start(rig, CHANNEL)
        track(session, {CHANNEL: [0.4, 1.2, 0.6, 0.4, 0.4, 0.6]}, 0.8)
        fastest = max(recorders.watch(rig, CHANNEL)["max_speed_rad_s"][:6])
        session.stop()
    assert 1.45 < fastest < 1.1 * 1.5
