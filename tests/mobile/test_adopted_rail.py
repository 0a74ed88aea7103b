"""The rail of a base whose loop was killed: its board is held by the dying process, and taken over once it is free."""

import contextlib
import fcntl

import pytest

from lerobot_robot_yam.control.mobile.base_controller import BaseController
from lerobot_robot_yam.control.preflight.open_bus import open_bus
from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.mobile.base_config import BaseConfig
from lerobot_robot_yam.mobile.rail_config import RailConfig
from lerobot_robot_yam.mobile.resolved_base import ResolvedBase
from lerobot_robot_yam.state.modes import Mode
from tests.mobile.converter import Converter
from tests.mobile.rails import Rail
from tests.support.waiting import wait

TICK_S = 0.004


@pytest.fixture
def converter():
    with contextlib.closing(Converter()) as converter:
        converter.outputs = {3: 1}  # as the dead loop has left it: the brake is released
        yield converter


@pytest.fixture
def held(converter):
    """The port as a dying process holds it, with the lock that pyserial takes."""
    with open(converter.port, "rb", buffering=0) as port:
        fcntl.flock(port, fcntl.LOCK_EX | fcntl.LOCK_NB)
        yield port


@pytest.fixture
def heir(tmp_path, converter, held):
    """The controller of a stand-by. The base's own loop ticks no more: nobody sleeps on its clock."""
    rail = Rail(tmp_path)
    with contextlib.closing(rail.rig), rail.base() as dead:
        record = dead._client.published()._record
        io = RailConfig(io="usb_gpio", port=converter.port)
        config = BaseConfig(channel="base", interface="yam_lockstep", can_options={"rig": rail.rig.name}, rail=io)
        with contextlib.closing(Heir(rail, converter, config, record)) as heir:
            yield heir


class Heir:
    def __init__(self, rail, converter, config, record):
        self.rail, self._converter, self._record, self._bus = rail, converter, record, open_bus(config)
        self.controller = BaseController(ResolvedBase(config), self._bus)

    def adopt(self):
        self.controller.adopt(self._record, self.rail.rig.now())

    def tick(self):
        """Tick once, in the order of the loop; the converter's output drives the rig's brake."""
        self.rail.board.requests(bytes((self._converter.outputs == {3: 0},)))
        controller, now = self.controller, self.rail.rig.now()
        controller.send()
        controller.collect(now + TICK_S)
        self.rail.rig.sleep(max(now + TICK_S - self.rail.rig.now(), 0.0))
        now = self.rail.rig.now()
        controller.measure(now)
        controller.decide(now)
        controller.advance(now, TICK_S)

    def close(self):
        self.controller.close()
        self._bus.shutdown()


def test_the_brake_is_engaged_once_the_port_is_free_and_then_torque_is_cut(heir, converter, held):
    heir.adopt()
    for _ in range(15):  # 60 ms
        heir.tick()
        assert converter.asked == [] and heir.controller.rail.sample.brake_on is None
    assert heir.controller.mode is Mode.LAND and heir.rail.enabled
    fcntl.flock(held, fcntl.LOCK_UN)
    wait(lambda: heir.controller.rail._io.read().brake_on)
    assert converter.outputs == {3: 0}
    for _ in range(500):
        heir.tick()
    assert heir.controller.mode is Mode.OFF and not heir.rail.enabled


def test_a_port_that_stays_in_use_keeps_the_motor_on(heir, converter, held, caplog):
    heir.adopt()
    for _ in range(500):
        heir.tick()
    assert heir.controller.mode is Mode.FAULT and heir.rail.enabled and converter.outputs == {3: 1}
    assert "not confirmed to be engaged" in heir.controller.status.message
    assert [record.message for record in caplog.records if "Could not exclusively lock port" in record.message]
    fcntl.flock(held, fcntl.LOCK_UN)
    wait(lambda: converter.outputs == {3: 0})


def test_the_brake_is_engaged_even_if_the_motors_have_let_go_and_nothing_is_left_to_do(heir, converter, held):
    heir.rail.rig.cut_torque("base")
    heir.adopt()
    assert heir.controller.mode is Mode.OFF
    fcntl.flock(held, fcntl.LOCK_UN)
    heir.controller.close()
    assert converter.outputs == {3: 0}


def test_an_ordinary_start_fails_at_once(heir, converter):
    with pytest.raises(ConfigError, match=rf"base: rail: {converter.port} cannot be opened: .*no other program uses"):
        heir.controller.rail.inspect()
