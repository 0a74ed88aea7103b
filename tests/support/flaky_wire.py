"""A wire between a client and a host that delays, loses and stalls what goes over it: a relay of TCP in a thread."""

import asyncio
import contextlib
import random
import threading

from lerobot_robot_yam.remote.host_address import HostAddress
from tests.support.hosted import free_port

_AGAIN_S = 0.04  # until a lost packet has been sent once more, and what waits behind it
_LOOK_S = 0.005


class FlakyWire:
    """Relays both ports of a host.

    Attributes:
        address: where clients find it.
        delay_s: each way.
        loss: share of packets that come later, and hold up what is behind them.
        stalled: nothing passes; it comes later.
    """

    def __init__(self, host):
        self.address = HostAddress("127.0.0.1", free_port())
        self.delay_s, self.loss, self.stalled = 0.0, 0.0, False
        self._host, self._draw = host, random.Random(1)
        self._loop = asyncio.new_event_loop()
        self._writers = set()
        self._ready = threading.Event()
        self._thread = threading.Thread(target=self._run)

    def __enter__(self):
        self._thread.start()
        self._ready.wait()
        return self

    def __exit__(self, *_):
        self._loop.call_soon_threadsafe(self._main.cancel)
        self._thread.join()

    def _run(self):
        self._main = self._loop.create_task(self._serve())
        with contextlib.suppress(asyncio.CancelledError):
            self._loop.run_until_complete(self._main)
        for task in asyncio.all_tasks(self._loop):
            task.cancel()
        self._loop.run_until_complete(asyncio.sleep(0.05))
        self._loop.close()

    async def _serve(self):
        async with contextlib.AsyncExitStack() as ends:
            for number in (0, 1):
                port = self._host.port + number

                async def relay(reader, writer, port=port):
                    with contextlib.suppress(OSError):
                        there_reader, there_writer = await asyncio.open_connection("127.0.0.1", port)
                        self._writers |= {writer, there_writer}
                        await asyncio.gather(self._pass(reader, there_writer), self._pass(there_reader, writer))

                server = await asyncio.start_server(relay, "127.0.0.1", self.address.port + number)
                await ends.enter_async_context(server)
            self._ready.set()
            try:
                await asyncio.Event().wait()
            finally:
                for writer in self._writers:
                    writer.close()

    async def _pass(self, reader, writer):
        queue: asyncio.Queue = asyncio.Queue()

        async def read():
            with contextlib.suppress(OSError):
                while data := await reader.read(1 << 16):
                    await queue.put((self._loop.time() + self.delay_s, data))
            await queue.put((0.0, b""))

        task = self._loop.create_task(read())
        with contextlib.suppress(OSError):
            while (item := await queue.get())[1]:
                await asyncio.sleep(max(0.0, item[0] - self._loop.time()))
                if self.loss and self._draw.random() < self.loss:
                    await asyncio.sleep(_AGAIN_S + 2.0 * self.delay_s)
                while self.stalled:
                    await asyncio.sleep(_LOOK_S)
                writer.write(item[1])
                await writer.drain()
        writer.close()
        task.cancel()

    def drop(self):
        """Close every connection."""

        def close():
            for writer in self._writers:
                writer.transport.abort()
            self._writers.clear()

        self._loop.call_soon_threadsafe(close)
