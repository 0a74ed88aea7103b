"""A controller that two pages watch while a script jogs, moves, teleports and grips: every status fits, nothing grows.

YAM_WALDO_SOAK_S says for how many seconds; a minute by default.
"""

import asyncio
import os
import random
from pathlib import Path

import pytest

from lerobot_robot_yam.errors import YamError
from lerobot_robot_yam.waldo.wire import ask_once
from tests.waldo.conformance import Host, free_port

pytestmark = [pytest.mark.long, pytest.mark.alone, pytest.mark.timeout(1200)]
SOAK_S = float(os.environ.get("YAM_WALDO_SOAK_S", "60"))
HOST, HOME = "127.0.0.1", [0.0, 60.0, 60.0, -29.0, 0.0, 0.0]
MOST_GROWTH_MB = 20.0


def resident_mb(pid):
    pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


async def act(client, numbers):
    """One thing that a person or a script does; the index of a command that shall be carried out, or None."""
    choice = numbers.random()
    if choice < 0.3:
        for _ in range(10):
            await client.jog_j(numbers.randrange(6), speed=numbers.uniform(-1, 1))
            await asyncio.sleep(0.05)
        await client.wait_motion(timeout=5.0)
    elif choice < 0.5:
        for _ in range(10):
            await client.jog_l("TRF", numbers.choice(["X", "Y", "Z", "RX", "RY", "RZ"]), numbers.uniform(-1, 1))
            await asyncio.sleep(0.05)
        await client.wait_motion(timeout=5.0)
    elif choice < 0.7:
        return await client.move_j([angle + numbers.uniform(-20, 20) for angle in HOME], speed=1.0)
    elif choice < 0.8:
        return await client.move_l([numbers.uniform(-20, 20), 0, numbers.uniform(-20, 20), 0, 0, 0], rel=True)
    elif choice < 0.9:
        for _ in range(30):
            await client.teleport([angle + numbers.uniform(-1, 1) for angle in HOME], [numbers.random()])
            await asyncio.sleep(0.02)
    else:
        await client.tool_action("LINEAR_4310", numbers.choice(["open", "close"]), wait=True)
    return None


def test_nothing_freezes_or_grows(waldoctl):
    from lerobot_robot_yam.waldo.robot import Robot

    async def run():
        robot, port, numbers, missed, refusals = Robot(), free_port(), random.Random(1), [], 0
        await asyncio.to_thread(robot.start, host=HOST, port=port)
        pid = ask_once(HOST, port, "ping")["pid"]
        clients = [robot.create_async_client(host=HOST, port=port) for _ in range(3)]
        pages = [Host(robot, "C") for _ in range(2)]
        watching = [asyncio.create_task(page.consume(client)) for page, client in zip(pages, clients, strict=False)]
        script, loop = clients[-1], asyncio.get_running_loop()
        await script.select_tool("LINEAR_4310")
        began, before = loop.time(), None
        while loop.time() < began + SOAK_S:
            try:
                index = await act(script, numbers)
            except YamError:
                refusals += 1
                index = await script.home()
            if index is not None and not await script.wait_command(index, timeout=20.0):
                missed.append(index)
            if before is None and loop.time() > began + 10.0:
                before = resident_mb(pid)
        grown = resident_mb(pid) - before
        for client in clients:
            await client.close()
        await asyncio.wait_for(asyncio.gather(*watching), 10.0)
        await asyncio.to_thread(robot.stop)
        return pages, missed, grown, refusals

    pages, missed, grown, refusals = asyncio.run(run())
    for page in pages:
        assert page.errors == {} and page.ended == "ended" and page.n > 20 * SOAK_S
    assert not missed and grown < MOST_GROWTH_MB and refusals < 0.2 * SOAK_S
