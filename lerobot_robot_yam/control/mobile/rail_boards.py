"""The boards that read the rail's switches and drive its brake, by the names that a configuration gives them."""

import importlib
from types import ModuleType

from lerobot_robot_yam.control.mobile.rail_brake import CONFIRM_S
from lerobot_robot_yam.errors import ConfigError, MotorError
from lerobot_robot_yam.mobile.resolved_base import ResolvedBase
from lerobot_robot_yam.system.boards.switch_board import BoardSample, SwitchBoard
from lerobot_robot_yam.system.clock import Clock
from lerobot_robot_yam.system.own_commands import install_extra

_DRIVERS = {
    "gpio": "system.boards.gpio_board",
    "usb_gpio": "system.boards.usb_board",
    "sim": "rig.client.rail_board_io",
}


def load_board(hardware: ResolvedBase) -> ModuleType:
    """Return the driver's module; the first import takes time. Raises ConfigError: a package is missing."""
    assert hardware.config.rail is not None
    name = hardware.config.rail.io
    try:
        return importlib.import_module(f"lerobot_robot_yam.{_DRIVERS[name]}")
    except ImportError as error:
        raise ConfigError(f"{hardware.name}: rail: io {name} needs {error.name}: {install_extra('rail')}") from error


def open_board(hardware: ResolvedBase) -> SwitchBoard:
    """Open the board, with the brake engaged. Raises YamError: it cannot be opened; the message says what to check."""
    driver, config, rail = load_board(hardware), hardware.config, hardware.config.rail
    assert rail is not None
    if rail.io == "sim":
        opened: SwitchBoard = driver.open_board(config.interface, config.channel, config.can_options)
    else:
        opened = driver.open_board(f"{hardware.name}: rail", rail.port, rail.wiring)
    return opened


def open_checked(hardware: ResolvedBase, clock: Clock) -> tuple[SwitchBoard, BoardSample]:
    """Open the board and check the switches; nothing moves. Raises YamError: no answer, or both are triggered."""
    assert hardware.config.rail is not None
    board, name, until_s = open_board(hardware), f"{hardware.name}: rail", clock.now() + CONFIRM_S
    try:
        while (sample := board.read()).brake_on is not True:
            if clock.now() > until_s:
                what = f"switches and brake ({hardware.config.rail.io}) do not answer; check cable and power"
                raise MotorError(f"{name}: {what}")
            clock.sleep(0.005)
        if sample.upper and sample.lower:
            raise MotorError(f"{name}: both switches read as triggered: their cable is off (an open wire reads so)")
    except BaseException:
        board.close()
        raise
    return board, sample
