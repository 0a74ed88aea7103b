"""How each trouble of an arm is brought about on the rig, in which phases, and what a start says of it."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from lerobot_robot_yam.damiao.tables import Fault
from lerobot_robot_yam.rig.simulation.rig_operations import RigOperations
from lerobot_robot_yam.state.faults import Trouble

LEFT, RIGHT, LEADER = "follower_left", "follower_right", "leader_left"
MOTOR = "joint_3"


@dataclass(frozen=True)
class Injected:
    """How one trouble is brought about, where, and what a refusal at bring-up says (None: it is no obstacle)."""

    trouble: Trouble
    inject: Callable[[RigOperations], Any]
    phases: tuple[str, ...] = ("bring_up", "hold", "track", "land")
    refused: str | None = ""
    names: str = MOTOR
    channel: str = LEFT


def on_motor(kind: str, value: Any = True, **details: Any) -> Callable[[RigOperations], Any]:
    return lambda rig: rig.fault(LEFT, MOTOR, kind, value, **details)


def on_channel(kind: str, value: Any = True, channel: str = LEFT) -> Callable[[RigOperations], Any]:
    return lambda rig: rig.fault(channel, None, kind, value)


def nibble(code: Fault) -> Callable[[RigOperations], Any]:
    return on_motor("nibble", int(code), sticky=True)


MOVING = ("hold", "track", "land")
FAULTS = {
    "over-voltage": Injected(Trouble.OVER_VOLTAGE, nibble(Fault.OVER_VOLTAGE), refused="cannot enable.*0x8"),
    "under-voltage": Injected(Trouble.UNDER_VOLTAGE, nibble(Fault.UNDER_VOLTAGE), refused="cannot enable.*0x9"),
    "over-current": Injected(Trouble.OVER_CURRENT, nibble(Fault.OVER_CURRENT), refused="cannot enable.*0xA"),
    "mos-hot": Injected(Trouble.MOS_TOO_HOT, nibble(Fault.MOS_OVER_TEMPERATURE), refused="cannot enable.*0xB"),
    "rotor-hot": Injected(Trouble.ROTOR_TOO_HOT, nibble(Fault.ROTOR_OVER_TEMPERATURE), refused="cannot enable.*0xC"),
    "comm-loss": Injected(Trouble.COMMUNICATION_LOST, nibble(Fault.COMMUNICATION_LOST), refused="cannot enable.*0xD"),
    "overload": Injected(Trouble.OVERLOAD, nibble(Fault.OVERLOAD), refused="cannot enable.*0xE"),
    "disabled": Injected(Trouble.DISABLED, on_motor("nibble", 0), MOVING),
    "motor-silent": Injected(Trouble.MOTOR_SILENT, on_motor("silent"), refused="no answer from 1 of 7"),
    "cable-out": Injected(Trouble.BUS_SILENT, on_channel("cable_out"), refused="no answer from 7", names=LEFT),
    "bus-off": Injected(Trouble.BUS_OFF, on_channel("bus_off"), refused="buffer space|no answer", names=LEFT),
    "link-down": Injected(Trouble.LINK_DOWN, on_channel("link_down"), refused="Network is down", names=LEFT),
    "adapter-gone": Injected(Trouble.ADAPTER_GONE, on_channel("adapter_gone"), refused="no such device", names=LEFT),
    "reply-lost": Injected(Trouble.REPLY_LOST, on_motor("drop_next", 1), MOVING),
    "burst-lost": Injected(Trouble.REPLIES_LOST, on_motor("drop_next", 12), MOVING),
    "wrong-id": Injected(Trouble.WRONG_ID, on_motor("wrong_id", 0x42), ("bring_up", "track"), refused="0x42"),
    "duplicate-id": Injected(
        Trouble.DUPLICATE_ID, on_motor("duplicate"), ("bring_up", "hold", "track"), refused="more than one answer"
    ),
    "second-arm": Injected(
        Trouble.DUPLICATE_ID, on_channel("second_arm"), ("bring_up", "hold", "track"), refused="more than one answer"
    ),
    "leap": Injected(Trouble.IMPLAUSIBLE, on_motor("reading", {"position_rad": 2.0}), MOVING),
    "turn": Injected(Trouble.IMPLAUSIBLE, on_motor("reading", {"position_rad": -2 * math.pi}), MOVING),
    # Of those with another motor's number in them nothing is known but that an answer is missing.
    "garbled": Injected(Trouble.IMPLAUSIBLE, on_motor("corrupt_rate", 0.3), MOVING),
    "foreign-driver": Injected(
        Trouble.FOREIGN_DRIVER,
        on_channel("foreign", {"id": 3, "rate_hz": 100.0}),
        ("bring_up", "hold"),
        refused="already being driven",
        names=LEFT,
    ),
    "handle-silent": Injected(
        Trouble.ENCODER_SILENT,
        on_channel("handle_silent", channel=LEADER),
        ("bring_up", "hold", "land"),
        refused="handle",
        names=LEADER,
        channel=LEADER,
    ),
    "warm": Injected(
        Trouble.WARM, on_motor("temperature_ramp", {"rate_c_per_s": 0.1, "from_c": 88.0}), ("bring_up", "track"), None
    ),
    "hot": Injected(
        Trouble.HOT, on_motor("temperature_ramp", {"rate_c_per_s": 0.1, "from_c": 96.0}), ("hold", "track")
    ),
}
