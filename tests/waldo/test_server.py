"""The controller over TCP: several clients, bad lines, readers that do not read, and what only its operator may ask."""

import asyncio
import contextlib
import json
import socket

import numpy as np
import pytest

from lerobot_robot_yam.errors import ControllerError
from lerobot_robot_yam.waldo.arm_choice import ArmChoice
from lerobot_robot_yam.waldo.controller.command_server import CommandServer
from lerobot_robot_yam.waldo.controller.controller import Controller
from lerobot_robot_yam.waldo.controller.controller_process import operator_acts
from lerobot_robot_yam.waldo.wire import MOST_BYTES, ask_operator_door, door_path
from tests.support.pages import block
from tests.waldo.conformance import HOST, free_port

HOME = [0, 60, 60, -29, 0, 0]
pytestmark = pytest.mark.usefixtures("waldoctl")


async def broken():
    raise RuntimeError("a defect")


@contextlib.asynccontextmanager
async def serving(port):
    """A controller of a simulated arm."""
    controller = Controller(ArmChoice().resolved())
    server = CommandServer(controller, operator_acts(controller) | {"break": broken})
    await server.open(HOST, port)
    try:
        yield server
    finally:
        await server.close()


def client_of(port, **options):
    from lerobot_robot_yam import AsyncRobotClient

    return AsyncRobotClient(HOST, port, **options)


async def raw(port, *lines):
    """What comes back for lines as they are, until the other side hangs up or is silent."""
    reader, writer = await asyncio.open_connection(HOST, port, limit=MOST_BYTES)
    answers = []
    with contextlib.suppress(ConnectionError):
        for line in lines:
            writer.write(line)
        await writer.drain()
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(0.3):
                while answer := await reader.readline():
                    answers.append(json.loads(answer))
                answers.append("closed")
    writer.close()
    return answers


def test_clients_share_one_arm_and_a_stop_holds_against_all():
    async def run():
        port = free_port()
        async with serving(port), client_of(port) as page, client_of(port) as script:
            index = await script.move_j([40, *HOME[1:]], speed=0.3)
            assert await page.wait_status(lambda status: status.executing_index == index)
            await page.estop()
            with pytest.raises(ControllerError, match="an e-stop is latched"):
                await script.move_j(HOME)
            assert await script.wait_command(index) is False
            await script.reset()
            assert await page.wait_command(await script.home(), timeout=20) is True
            np.testing.assert_allclose(await page.angles(), HOME, atol=0.01)

    asyncio.run(run())


def test_what_a_stop_has_overtaken_does_nothing():
    def line(do, number, client="page", **arguments):
        return json.dumps({"do": do, "with": arguments, "client": client, "number": number}).encode() + b"\n"

    async def run():
        port, jog = free_port(), {"joints": [0], "speeds": [0.5], "duration": 5.0}
        async with serving(port) as server:
            for stop, late in (
                (line("stop", 8), line("jog_j", 6, **jog)),
                (line("stop", 8), line("home", 5)),
                (line("estop", 10), line("reset", 9)),
            ):
                (stopped, _), (answer, _) = await raw(port, stop), await raw(port, late)
                assert "result" in stopped and "overtaken" in answer["refused"]
            assert server.controller.stopped
            (there, _), (newer, _) = await raw(port, line("ping", 4)), await raw(port, line("reset", 11))
            assert "result" in there and "result" in newer and not server.controller.stopped
            (other, _) = await raw(port, line("jog_j", 1, client="script", **jog))
            assert "result" in other

    asyncio.run(run())


def test_bad_lines_are_answered_or_end_their_own_connection_alone():
    async def run():
        port = free_port()
        async with serving(port), client_of(port) as client:
            for line in (b"hello\n", b"[1]\n", b"\xff\xfe\n", b"x" * (2 * MOST_BYTES)):
                assert await raw(port, line) in (["closed"], [])
            for line, words in (
                (b'{"do": "arm", "with": {}}\n', "the controller knows no request 'arm'"),
                (b'{"do": "jog_j", "with": {"joints": [0], "speeds": [NaN]}}\n', "a number from -1 to 1, not nan"),
                (b'{"do": "move_j", "with": []}\n', "move_j"),
            ):
                answer, end = await raw(port, line)
                assert words in answer["refused"] and end == "closed"
            assert (await client.ping()).hardware_connected is False

    asyncio.run(run())


def test_statuses_do_not_pile_up_for_a_reader_that_does_not_read():
    async def run():
        port = free_port()
        async with serving(port) as server:
            with socket.create_connection((HOST, port)) as idle:
                idle.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
                idle.sendall(b'{"do": "stream", "with": {}}\n')
                while not server._subscribers:
                    await asyncio.sleep(0.01)
                (writer,) = server._subscribers
                writer.get_extra_info("socket").setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 4096)
                for _ in range(400):  # some 500 kB
                    server.broadcast()
                assert 1 << 15 < writer.transport.get_write_buffer_size() < 1 << 17

    asyncio.run(run())


def test_a_stream_goes_on_with_the_next_controller():
    async def run():
        port, seen = free_port(), []

        async def watch():
            async for status in client.stream_status_shared():
                seen.append(status.session_id)

        client = client_of(port)
        watching = asyncio.create_task(watch())
        for _ in range(2):
            async with serving(port) as server:
                while server.controller.session_id not in seen:
                    await asyncio.sleep(0.02)
        await client.close()
        await asyncio.wait_for(watching, 2.0)
        assert len(set(seen)) == 2

    asyncio.run(run())


def test_without_a_controller_a_client_says_how_to_start_one():
    async def run():
        client = client_of(free_port())
        assert await client.ping() is None and await client.angles() is None
        assert await client.wait_ready(timeout=0.1) is False
        with pytest.raises(ControllerError, match="no controller on .* start it: yam-waldo"):
            await client.home()
        with pytest.raises(ControllerError, match="no tool was selected through this client"):
            client.tool  # noqa: B018

    asyncio.run(run())


def test_a_port_has_one_controller():
    async def run():
        port = free_port()
        async with serving(port):
            with pytest.raises(ControllerError, match="cannot be served"):
                async with serving(port):
                    pass

    asyncio.run(run())


def test_only_the_operators_door_knows_arm_and_land():
    async def run():
        port = free_port()
        async with serving(port):
            assert door_path(port).stat().st_mode & 0o777 == 0o600
            for act, words in (
                ("arm", "has no hardware"),
                ("about", "only a simulated arm"),
                ("home", "knows no request 'home'"),
                ("break", "break failed .RuntimeError."),
            ):
                with pytest.raises(ControllerError, match=words):
                    await asyncio.to_thread(ask_operator_door, port, act)
            assert "has landed" in await asyncio.to_thread(ask_operator_door, port, "land")
        with pytest.raises(ControllerError, match="no controller of yours serves port"):
            ask_operator_door(port, "land")

    asyncio.run(run())


def test_the_script_of_the_page_does_what_it_says():
    code = block("docs/waldo.md", "python", "RobotClient()")

    async def run():
        port = free_port()
        async with serving(port) as server:
            await asyncio.to_thread(exec, code.replace("RobotClient()", f"RobotClient({HOST!r}, {port})"), {})
            assert server.report.status()["tool"]["positions"] == [1.0]
            np.testing.assert_allclose(server.report.angles(), HOME, atol=0.01)

    asyncio.run(run())


def test_the_blocking_client_has_the_calls_of_the_other_one():
    from lerobot_robot_yam import RobotClient

    async def run(work):
        port = free_port()
        async with serving(port):
            await asyncio.to_thread(work, port)

    def script(port):
        with RobotClient(HOST, port) as rbt:
            assert rbt.tool.key == "NONE"
            rbt.select_tool("linear_4310")
            rbt.tool.close(wait=True)
            first = rbt.move_j([5, *HOME[1:]], speed=0.5, wait=True)
            assert rbt.move_l([0, 0, 10, 0, 0, 0], rel=True, wait=True) == first + 1
            assert rbt.wait_motion() and rbt.angles()[0] != 0.0
            assert rbt.status()["tool"]["positions"] == [1.0]
            with pytest.raises(ControllerError, match="NONE, LINEAR_4310"):
                rbt.select_tool("SPOON")
            with pytest.raises(NotImplementedError):
                rbt.move_c([0] * 6, [0] * 6)

    asyncio.run(run(script))
