"""A motor that ends below the range of its frames, as a DM4310 at 7 of 10 Nm, is believed; one that lies is not."""

import numpy as np
import pytest

from lerobot_robot_yam.control.safety.torque_check import TorqueCheck


@pytest.mark.parametrize("tau_nm, believed", [(9.5, True), (7.0, True), (3.0, False), (-7.0, False)])
def test_a_motor_that_gives_less_than_its_range_is_believed(tau_nm, believed):
    check = TorqueCheck(np.array([10.0]))
    lying = []
    for tick in range(30):
        sample = np.array([-0.95]), np.zeros(1), np.array([tau_nm]), np.array([0.004 * tick])
        lying += check.lying(np.array([[0.0, 0.0, 10.0, 1.5, 0.0]]), *sample, np.array([True]))
    assert (not lying) is believed
