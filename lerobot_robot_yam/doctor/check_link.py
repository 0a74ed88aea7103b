"""Check of the CAN interfaces with the system's own tools: `ip` for the link, `tc` for its queue.

Field names: iproute2's `ip/iplink_can.c` (link) and `tc/tc_qdisc.c` (queue).
"""

import json
import subprocess
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from lerobot_robot_yam.damiao.bus_port import RESET_LINK
from lerobot_robot_yam.damiao.tables import BITRATE
from lerobot_robot_yam.doctor.kit.findings import Section

IP_COMMAND = ("ip", "-details", "-statistics", "-json", "link", "show", "type", "can")
TC_COMMAND = ("tc", "-statistics", "-json", "qdisc", "show")
RESTART_MS = 100
# Minimum and recommended length of the transmit queue, frames. A tick of the control loop queues 8 frames at once. The
# kernel's default of 10 leaves no room for a late tick; a very long queue sends stale commands to motors that return.
QUEUE_MIN, QUEUE_LENGTH = 32, 100
# Drivers without a restart handler: newer kernels refuse `restart-ms` (older ones crash when it takes effect:
# "can: netlink: can_changelink(): fix NULL pointer deref of struct can_priv::do_set_mode", 2025).
NO_RESTART = frozenset({"gs_usb"})
# Controller mode that disturbs the arms -> `ip`'s name of the mode. In the first two, no frame reaches the motors.
_WRONG_MODES = {"LISTEN-ONLY": "listen-only", "LOOPBACK": "loopback", "FD": "fd", "ONE-SHOT": "one-shot"}
_DEAF_MODES = {"LISTEN-ONLY", "LOOPBACK"}
_STOPPED = ("BUS-OFF", "STOPPED", "SLEEPING")
_BUS_OFF = "bus-off: the controller has given up after too many errors and sends nothing"
_CHECK_CABLE = "check the CAN cable and the terminators (120 Ω at both ends)"
_TOOL_TIMEOUT_S = 10.0


@dataclass(frozen=True)
class Link:
    """CAN interface. None: the system does not report the value.

    Attributes:
        driver: driver of the controller, such as "gs_usb".
        state: "ERROR-ACTIVE" (healthy), "ERROR-WARNING", "ERROR-PASSIVE", "BUS-OFF", "STOPPED", "SLEEPING".
        modes: active controller modes ("FD", "LISTEN-ONLY", …).
        queue_length: maximum queue length, frames (txqueuelen); waiting: frames in the queue.
        refused, dropped, lost_rx: numbers of frames refused by a full queue, dropped by driver, lost by adapter.
        device: hardware device, such as USB interface "1-2:1.0".
    """

    name: str
    up: bool
    driver: str | None = None
    state: str | None = None
    bitrate: int | None = None
    modes: tuple[str, ...] = ()
    restart_ms: int | None = None
    queue_length: int | None = None
    waiting: int | None = None
    refused: int | None = None
    dropped: int | None = None
    lost_rx: int | None = None
    tx_errors: int | None = None
    rx_errors: int | None = None
    bus_offs: int | None = None
    device: str | None = None

    @property
    def usable(self) -> bool:
        """Whether motors can be queried through the link without harm (a wrong bit-rate disturbs the bus)."""
        return (
            self.up
            and self.state not in _STOPPED
            and self.bitrate in (None, BITRATE)
            and not _DEAF_MODES & set(self.modes)
            and not self.full
        )

    @property
    def full(self) -> bool:
        """Whether the transmit queue is full: another frame would get "No buffer space available"."""
        return bool(self.queue_length) and (self.waiting or 0) >= (self.queue_length or 0)

    def repair(self) -> str:
        """Return the command that restores the interface to the state that the arms need."""
        wrong = [f"{option} off" for mode, option in _WRONG_MODES.items() if mode in self.modes]
        if not wrong:
            return f"{RESET_LINK} {self.name}"
        up = f"sudo ip link set {self.name} up txqueuelen {QUEUE_LENGTH} type can bitrate {BITRATE}"  # order matters
        if self.driver is not None and self.driver not in NO_RESTART:  # a refused option would leave the link down
            wrong.append(f"restart-ms {RESTART_MS}")
        return " ".join([f"sudo ip link set {self.name} down &&", up, *wrong])


def tool_output(command: Sequence[str]) -> tuple[str | None, str]:
    """Run a read-only tool; return its standard output and "", or None and the reason of the failure."""
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=_TOOL_TIMEOUT_S, check=False)
    except (OSError, subprocess.TimeoutExpired) as error:
        return None, str(error)
    if done.returncode != 0:
        return None, done.stderr.strip() or f"exit status {done.returncode}"
    return done.stdout, ""


def parse_links(ip_json: str, tc_json: str | None = None) -> list[Link]:
    """Parse the JSON of `IP_COMMAND` and, for the queues, `TC_COMMAND`. Raises ValueError: the JSON differs in form."""
    queues = {row.get("dev", ""): row for row in _rows(tc_json or "[]") if row.get("root")}
    return [_link(row, queues.get(row["ifname"], {})) for row in _rows(ip_json) if "ifname" in row]


def _rows(text: str) -> list[dict[str, Any]]:
    rows = json.loads(text or "[]")
    if not isinstance(rows, list) or not all(isinstance(row, dict) for row in rows):
        raise ValueError("not a list of JSON objects")
    return rows


def _link(row: dict[str, Any], queue: dict[str, Any]) -> Link:
    info = row.get("linkinfo") or {}
    data, counts = info.get("info_data") or {}, info.get("info_xstats") or {}
    statistics = row.get("stats64") or {}
    errors = data.get("berr_counter") or {}
    return Link(
        name=row["ifname"],
        up="UP" in row.get("flags", ()),
        driver=(data.get("bittiming_const") or {}).get("name"),
        state=data.get("state"),
        # The second form is for controllers with a few fixed bit-rates.
        bitrate=(data.get("bittiming") or {}).get("bitrate") or data.get("bittiming_bitrate"),
        modes=tuple(data.get("ctrlmode") or ()),
        restart_ms=data.get("restart_ms"),
        queue_length=row.get("txqlen"),
        waiting=queue.get("qlen"),
        refused=queue.get("drops"),
        dropped=(statistics.get("tx") or {}).get("dropped"),
        lost_rx=(statistics.get("rx") or {}).get("over_errors"),
        tx_errors=errors.get("tx"),
        rx_errors=errors.get("rx"),
        bus_offs=counts.get("bus_off"),
        device=row.get("parentdev"),
    )


def check_links(links: Sequence[Link], wanted: Sequence[str], section: Section) -> None:
    """Add rows for all links, and findings for the wanted links."""
    for link in links:
        row = {key: getattr(link, key) for key in Link.__dataclass_fields__}
        section.rows.append({**row, "modes": list(link.modes), "link": "up" if link.up else "down"})
        if link.name in wanted:
            _check(link, section)


def _check(link: Link, section: Section) -> None:
    name = link.name
    if not link.up:
        section.problem(name, "the interface is down (arms look unpowered)", link.repair())
        return
    if link.state in _STOPPED:
        what = _BUS_OFF if link.state == "BUS-OFF" else f"the controller is {link.state.lower()}"
        section.problem(name, what, link.repair())
    elif link.state == "ERROR-PASSIVE":
        counters = "" if link.tx_errors is None else f" (transmit errors {link.tx_errors}, receive {link.rx_errors})"
        what = f"error-passive{counters}: frames are not acknowledged or arrive damaged"
        section.problem(name, what, f"switch the arm's power on, then {_CHECK_CABLE}")
    elif link.state == "ERROR-WARNING":
        section.warn(name, "error-warning: many frames arrive damaged", _CHECK_CABLE)
    elif link.state is None:
        section.note(name, "the controller's state is unknown: the driver does not tell", "nothing to do")
    if link.bitrate is not None and link.bitrate != BITRATE:
        section.problem(name, f"the bit-rate is {link.bitrate} instead of {BITRATE} bit/s", link.repair())
    for mode in sorted(set(link.modes) & set(_WRONG_MODES)):
        fd = "CAN FD is on: the motors speak classic CAN, and one FD frame disturbs them all"
        section.problem(name, fd if mode == "FD" else f"the controller is in {mode.lower()} mode", link.repair())
    if link.full:
        what = f"no buffer space: {link.waiting} frames wait in a queue of {link.queue_length} and none gets through, "
        what += "since nobody acknowledges them (arm without power, cable out) or the adapter hangs"
        section.problem(name, what, link.repair())
    elif link.queue_length is not None and link.queue_length < QUEUE_MIN:
        what = f"the transmit queue holds only {link.queue_length} frames (txqueuelen): a late tick gets 'No buffer "
        section.warn(name, f"{what}space'", f"sudo ip link set {name} txqueuelen {QUEUE_LENGTH}")
    lost = {"refused by a full queue": link.refused, "dropped by the driver": link.dropped}
    if texts := [f"{count} {how}" for how, count in lost.items() if count]:
        what = f"the interface has lost frames that it should send: {', '.join(texts)}"
        section.warn(name, what, "switch the arm's power on before a session starts, and check its CAN cable")
    if link.restart_ms == 0 and link.driver is not None and link.driver not in NO_RESTART:
        what = "restart-ms is 0: after bus-off the controller stays off until somebody restarts it"
        section.warn(name, what, link.repair())
    if link.restart_ms and link.driver in NO_RESTART:
        what = f"restart-ms is {link.restart_ms}, which {link.driver} cannot do (some kernels crash at bus-off)"
        section.warn(name, what, f"sudo ip link set {name} down && sudo ip link set {name} up type can restart-ms 0")
    if link.bus_offs:
        what = f"the controller has been bus-off since it was plugged in (times: {link.bus_offs})"
        section.warn(name, what, _CHECK_CABLE)
    if link.lost_rx:
        what = f"the adapter has lost {link.lost_rx} received frames"
        section.warn(name, what, "plug the adapter into a separate USB port, without a hub")
