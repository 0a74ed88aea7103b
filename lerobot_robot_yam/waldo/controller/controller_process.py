"""Process of the controller: serves until a signal arrives or its parent process ends, and then lands the arm.

    python -m lerobot_robot_yam.waldo.controller.controller_process --port 5001

It is started by `yam-waldo`, or by Commander through `Robot.start`. It begins in simulator mode and energises nothing.
"""

import argparse
import asyncio
import contextlib
import json
import logging
import os
import signal
import sys
from collections.abc import Awaitable, Callable, Sequence

from lerobot_robot_yam.arm.config import ArmConfig
from lerobot_robot_yam.arm.mounting import seeks_stops
from lerobot_robot_yam.arm.resolved_arm import ResolvedArm
from lerobot_robot_yam.control.process.lifeline import ProcessEnd
from lerobot_robot_yam.errors import ControllerError, YamError
from lerobot_robot_yam.session.arm_session import still_in_the_air
from lerobot_robot_yam.waldo.arm_choice import ArmChoice
from lerobot_robot_yam.waldo.controller.command_server import CommandServer
from lerobot_robot_yam.waldo.controller.controller import Controller
from lerobot_robot_yam.waldo.controller.plant import RealArm
from lerobot_robot_yam.waldo.wire import HOST, PORT

_LOOK_S = 0.2
_SWITCH_S = 0.001  # maximum delay of a tick by the planning thread, s; Python's default of 5 ms is half a tick

logger = logging.getLogger(__name__)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the controller; return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--host", default=HOST, help=f"address to serve (default {HOST}: this computer only)")
    parser.add_argument("--port", type=int, default=PORT, help=f"port to serve (default {PORT})")
    parser.add_argument("--arm-config", metavar="JSON", help="the real arm, as an ArmConfig; without it there is none")
    parser.add_argument("--parent", type=int, help="process with which it ends; an arm is landed")
    args = parser.parse_args(arguments)
    logging.basicConfig(level=logging.INFO, format="%(levelname)s %(message)s")
    sys.setswitchinterval(_SWITCH_S)
    try:
        config = None if args.arm_config is None else ArmConfig(**json.loads(args.arm_config))
        asyncio.run(serve(args.host, args.port, config, args.parent))
    except YamError as error:
        sys.stderr.write(f"controller: {error}\n")
        return 1
    return 0


async def serve(
    host: str,
    port: int,
    config: ArmConfig | None,
    parent: int | None = None,
    opened: Callable[[], None] = lambda: None,
) -> None:
    """Serve one arm until a signal arrives or the parent process ends, and then land the arm.

    Args:
        host, port: address to listen on.
        config: config of the real arm; None: serve only the simulated arm given by the environment.
        parent: process whose end also ends this one; None: only a signal does.
        opened: called when the server is ready.

    Raises:
        YamError: the server cannot be started.
    """
    if config is None:
        controller = Controller(ArmChoice.of_environment().resolved())
    else:
        controller = Controller(ResolvedArm(config), RealArm(config))
    server = CommandServer(controller, operator_acts(controller))
    ended = asyncio.Event()
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        asyncio.get_running_loop().add_signal_handler(number, ended.set)
    await server.open(host, port)
    try:
        opened()
        await _ended(ended, parent)
        await controller.land()
    finally:
        await server.close()


def operator_acts(controller: Controller) -> dict[str, Callable[[], Awaitable[str]]]:
    """Return request name → function for the operator's requests. Each function returns a report of its result."""

    async def about() -> str:
        real = controller.real
        if real is None:
            raise ControllerError("this controller has only a simulated arm: start it with --hardware --channel …")
        return json.dumps({"channel": real.config.channel, "seeks": seeks_stops(real.config)})

    async def arm() -> str:
        await controller.arm()
        return f"{controller.hardware.name} is armed, and holds where it is"

    async def land() -> str:
        name = controller.hardware.name
        if not await controller.land():
            raise ControllerError(still_in_the_air(f"{name.upper()} IS"))
        return f"{name} has landed"

    return {"about": about, "arm": arm, "land": land}


async def _ended(told: asyncio.Event, parent: int | None) -> None:
    """Wait for a signal or for the end of the parent process."""
    try:
        watched = None if parent is None else ProcessEnd(parent)
    except FileNotFoundError:  # the parent has ended already
        return
    while not told.is_set() and (watched is None or not watched.reached()):
        with contextlib.suppress(TimeoutError):
            await asyncio.wait_for(told.wait(), _LOOK_S)
    logger.info("process %d ends: %s", os.getpid(), "it was told to" if told.is_set() else "its parent has gone")


if __name__ == "__main__":
    sys.exit(main())
