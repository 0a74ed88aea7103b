"""python-can interface `yam_sim`: one CAN channel of a virtual rig.

    can.Bus(interface="yam_sim", channel="follower_left")

Works with any python-can program. The rig starts on demand and ends with its last client. The keyword `rig` or the
environment variable YAM_RIG selects the rig by name (default "auto": the rig of this process).

Like a SocketCAN socket, a bus receives the frames that other clients send after it was opened, and loses frames if the
program does not read. With an injected fault (`control.RigControl.fault`) a bus raises the errors of python-can's
SocketCAN bus.
"""

import contextlib
import select
import socket
import time
from collections import deque
from collections.abc import Sequence
from typing import Any

import can

from lerobot_robot_yam.damiao.tables import BITRATE
from lerobot_robot_yam.errors import BusError, ConfigError
from lerobot_robot_yam.rig.bus.link_state import ClientLink, watch_link
from lerobot_robot_yam.rig.client import launch
from lerobot_robot_yam.rig.devices import packets
from lerobot_robot_yam.rig.devices.packets import Frame, message_of, pack_messages

# Keywords of other python-can interfaces, which generic callers pass to every interface; ignored by this one.
_FOREIGN_OPTIONS = frozenset(
    ("bitrate", "data_bitrate", "timing", "single_handle", "local_loopback", "ignore_rx_error_frames", "tseg1_abr")
)
_SELECTABLE = 1024  # first descriptor that is too large for `select`


class YamSimBus(can.BusABC):
    """One client of one channel. One thread may send while another receives.

    Args:
        channel: a channel of the rig's scene, for example "follower_left".
        can_filters: see `can.BusABC`.
        rig: name of the rig, see `runtime_files.rig_name`.
        scene: scene to use if this bus starts the rig.
        fd: must be False, because the motors use classic CAN.
        bitrate: must be 1 Mbit/s or None.
        options: scene options to use if this bus starts the rig (`latency_s=0.00025`).

    Raises:
        BusError: there is no such channel, the adapter is unplugged, or the bit rate or `fd` is wrong.
        ConfigError: an option or the scene is unknown.
        RigError: the rig cannot be started.
    """

    def __init__(
        self,
        channel: str,
        can_filters: Any = None,
        *,
        rig: str | None = None,
        scene: str | None = None,
        fd: bool = False,
        bitrate: int | None = None,
        receive_own_messages: bool = False,
        **options: Any,
    ):
        self._socket: socket.socket | None = None
        if fd:
            raise BusError(f"{channel}: the arms speak classic CAN; open the channel without CAN FD (fd=False)")
        if bitrate is not None and int(bitrate) != BITRATE:
            raise BusError(f"{channel}: the motors run at 1 Mbit/s, not {bitrate} bit/s")
        if receive_own_messages:
            raise ConfigError(f"{channel}: yam_sim does not echo own messages")
        options = {key: value for key, value in options.items() if key not in _FOREIGN_OPTIONS}
        hello = {"kind": "bus", "channel": str(channel)}
        self._socket, self.rig, answer = launch.connect_or_start(rig, hello, scene, options)
        self._arrived: deque[Frame] = deque()
        self.channel = channel
        self.channel_info = f"yam_sim channel {channel} of rig {self.rig}"
        try:
            self._link = ClientLink(watch_link(launch.rig_path(self.rig, "links"), answer["link"]), answer["unplugs"])
        except OSError as error:
            self._socket.close()
            raise self._gone() from error
        super().__init__(channel=channel, can_filters=can_filters)

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Queue one frame for the wire.

        Raises:
            BusError: the rig has ended, or the frame is not classic CAN.
            can.CanOperationError: the interface is down, gone or blocked, see `RigControl.fault`.
        """
        self.send_many((msg,), timeout)

    def send_many(self, messages: Sequence[can.Message], timeout: float | None = None) -> None:
        """Queue frames for the wire in one system call; they are transmitted in this order, back to back.

        Raises:
            BusError: the rig has ended or accepts no frames, or a frame is not classic CAN.
            can.CanOperationError: as for `send`.
        """
        packet = pack_messages(messages, time.monotonic())
        if self._socket is None:
            raise BusError(f"{self.channel_info} is shut down")
        if not self._link.check_send(len(messages)):
            return
        try:
            if timeout is not None and not _wait(self._socket, select.POLLOUT, timeout):
                raise BusError(f"{self.channel_info}: the rig takes no frames; is its process stopped?")
            self._socket.send(packet)
        except (BrokenPipeError, ConnectionResetError, ValueError) as error:  # ValueError: shut down by another thread
            raise self._gone() from error

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        deadline = None if timeout is None else time.monotonic() + timeout
        check = self._link.check_receive
        while True:
            check()
            if not self._arrived:  # reading the socket takes longer than all the rest
                self._fetch(0.0)
            now = time.monotonic()
            if self._arrived:
                wait = self._arrived[0].stamp_s - now
                if wait <= 0.0:
                    return message_of(self._arrived.popleft(), self.channel), False
                if deadline is not None and self._arrived[0].stamp_s > deadline:
                    # The wire preserves the order: no other frame arrives before this one.
                    time.sleep(max(0.0, deadline - now))
                    return None, False
                time.sleep(wait)
                continue
            remaining = None if deadline is None else deadline - now
            if remaining is not None and remaining <= 0.0:
                return None, False
            self._fetch(remaining)

    def _fetch(self, timeout: float | None) -> None:
        """Move the rig's packets into the queue; wait for the first packet for at most `timeout` s."""
        sock = self._socket
        if sock is None:
            raise BusError(f"{self.channel_info} is shut down")
        try:
            if timeout != 0.0 and not _wait(sock, select.POLLIN, timeout):
                return
            while True:
                packet = sock.recv(launch.MAX_PACKET, socket.MSG_DONTWAIT)
                if not packet:
                    if self._arrived:  # frames already on the wire are still delivered
                        return
                    raise self._gone()
                if packet != packets.WAKE:
                    self._arrived.extend(packets.unpack(packet))
        except BlockingIOError:
            return
        except (OSError, ValueError) as error:  # the socket was reset, or shut down by another thread
            raise self._gone() from error

    def _gone(self) -> BusError:
        crash = launch.rig_path(self.rig, "crash")
        return BusError(f"{self.channel_info}: the rig has ended" + (f"; see {crash}" if crash.exists() else ""))

    def flush_tx_buffer(self) -> None:
        """Do nothing, because the rig accepts frames immediately."""

    def fileno(self) -> int:
        """Return -1, which forbids `select`: a readable socket does not mean that the wire has delivered a frame."""
        return -1

    def shutdown(self) -> None:
        """Leave the channel. Idempotent."""
        super().shutdown()
        sock, self._socket = self._socket, None
        if sock is not None:
            with contextlib.suppress(OSError):
                sock.shutdown(socket.SHUT_RDWR)  # also ends the socket's copy in a forked child
            sock.close()

    @staticmethod
    def _detect_available_configs() -> list[Any]:
        return []


def _wait(sock: socket.socket, event: int, timeout_s: float | None) -> bool:
    """Wait for a socket with select (resolution 1 µs), or for descriptors above 1023 with poll (resolution 1 ms)."""
    timeout_s = None if timeout_s is None else max(0.0, timeout_s)
    if 0 <= sock.fileno() < _SELECTABLE:
        reads, writes = ([sock], []) if event == select.POLLIN else ([], [sock])
        return any(select.select(reads, writes, [], timeout_s))
    poll = select.poll()
    poll.register(sock, event)
    return bool(poll.poll(None if timeout_s is None else timeout_s * 1e3))
