"""Checks before motors are energised: is the channel free and fast enough, and are they the expected motors?"""

import logging
from collections import Counter
from collections.abc import Collection

import can

from lerobot_robot_yam.damiao.bus_port import BusPort, is_classic_data
from lerobot_robot_yam.damiao.chain import MotorChain
from lerobot_robot_yam.damiao.motor_spec import MotorSpec
from lerobot_robot_yam.damiao.registers import Register, agrees
from lerobot_robot_yam.damiao.tables import (
    BANDWIDTH_MARGIN,
    BITRATE,
    BITS_PER_FRAME,
    FORCE_POSITION_OFFSET,
    POSITION_VELOCITY_OFFSET,
    REGISTER_ID,
    TIMEOUT_COUNT_S,
    VELOCITY_OFFSET,
    WATCHDOG_S,
    motor_type,
)
from lerobot_robot_yam.errors import ChannelInUseError, ConfigError, MotorError

logger = logging.getLogger(__name__)

LISTEN_S = 0.05
_MOST_LATE_FRAMES = 1_000  # more frames than a bus can carry while `listen` runs
_PRESENCE_ATTEMPTS = 3
_DUPLICATE_WAIT_S = 0.01


def check_bandwidth(motors: int, encoder: bool, rate_hz: float) -> None:
    """Check that the wire can carry a loop rate: 2 · devices · 130 bit · rate ≤ bitrate / 1.1.

    Raises:
        ConfigError: the rate is too high; the message states the maximum rate.
    """
    bits_per_tick = 2 * (motors + encoder) * BITS_PER_FRAME
    limit_hz = BITRATE / BANDWIDTH_MARGIN / bits_per_tick
    if rate_hz > limit_hz:
        raise ConfigError(
            f"{motors} motors{' and a handle' if encoder else ''} at {rate_hz:g} Hz do not fit a CAN bus of "
            f"{BITRATE} bit/s; at most {limit_hz:.0f} Hz do"
        )


def listen(bus: can.BusABC, seconds: float, ids: Collection[int], channel: str = "") -> None:
    """Listen, without sending, for another driver that commands the motors with these ids.

    Locks exclude only processes of this package. Replies of motors count as well as commands, since motors send
    only when requested. Frames of other devices are only logged.

    Raises:
        ChannelInUseError: another driver's frames were received.
        BusError: the channel cannot be read.
    """
    commands = {
        base + i for base in (0, POSITION_VELOCITY_OFFSET, VELOCITY_OFFSET, FORCE_POSITION_OFFSET) for i in ids
    } | {REGISTER_ID}
    answers = {i + 16 for i in ids} | {0}
    seen: Counter[int] = Counter()
    port = BusPort(bus, channel)
    deadline = port.clock.now() + seconds
    # Frames that arrived before the deadline count even if they are read later; the limit ends a flood of frames.
    late = 0
    while late < _MOST_LATE_FRAMES:
        remaining = deadline - port.clock.now()
        late += remaining <= 0.0
        message = port.recv(max(remaining, 0.0))
        if message is None and remaining <= 0.0:
            break
        if message is not None and is_classic_data(message):
            seen[message.arbitration_id] += 1
    traffic = {can_id: count for can_id, count in seen.items() if can_id in commands or can_id in answers}
    if traffic:
        listing = ", ".join(f"0x{can_id:X} ({count})" for can_id, count in sorted(traffic.items()))
        raise ChannelInUseError(
            f"CAN channel {channel} is already being driven: heard identifiers {listing} within "
            f"{seconds * 1e3:.0f} ms before sending anything; stop the other program, or the other computer "
            "on this bus, and try again"
        )
    if seen:
        logger.info("CAN channel %s: other devices talk: %s", channel, ", ".join(f"0x{i:X}" for i in sorted(seen)))


def verify(chain: MotorChain) -> None:
    """Check that every motor is present, has a unique id and is configured as in the profile. Energises nothing.

    Compares PMAX, VMAX, TMAX and GR with the motor type, MST_ID and CTRL_MODE with both modes, TIMEOUT with
    `WATCHDOG_S`.

    Raises:
        MotorError: a motor is missing or a register differs; the message states both values and what to check.
    """
    _check_presence(chain)
    contradictions: list[str] = []
    for i, spec in enumerate(chain.motors):
        for register, value in expected_registers(spec).items():
            found = chain.read_register(i, register)
            exact = register.kind == "uint32"  # identifiers and counts
            if not (found == value if exact else agrees(found, value)):
                contradictions.append(
                    f"motor {spec.name} (id {spec.can_id}, {spec.type}): {register.name} is {found:g} instead of "
                    f"{value:g} {register.unit}"
                )
    if contradictions:
        raise MotorError(
            f"{chain.channel}: " + "; ".join(contradictions) + ". Check that arm and gripper in the configuration "
            "match the hardware, or correct the registers of the motor"
        )


def expected_registers(spec: MotorSpec) -> dict[Register, float]:
    """Return register -> required value of a motor, in the unit of the register."""
    row = motor_type(spec.type)
    expected: dict[Register, float] = {
        Register.PMAX: row.position_max_rad,
        Register.VMAX: row.velocity_max_rad_s,
        Register.TMAX: row.torque_max_nm,
        Register.TIMEOUT: round(WATCHDOG_S / TIMEOUT_COUNT_S),
        Register.MST_ID: spec.feedback_id,
        Register.CTRL_MODE: spec.mode,
    }
    if row.gear_ratio is not None:
        expected[Register.GR] = row.gear_ratio
    return expected


def _check_presence(chain: MotorChain) -> None:
    present = [False] * len(chain)
    for _ in range(_PRESENCE_ATTEMPTS):
        present = [a or b for a, b in zip(present, chain.refresh(), strict=True)]
        if all(present):
            break
    missing = [m for i, m in enumerate(chain.motors) if not present[i] and not _answers_register(chain, i)]
    if missing:
        names = ", ".join(f"{spec.name} (id {spec.can_id})" for spec in missing)
        strangers = ", ".join(f"0x{can_id:X}" for can_id in sorted(chain.foreign))
        if len(missing) == len(chain):
            check = "motor power and the emergency stop, the CAN cable and its terminator, and the bit-rate "
            check += "(classic CAN, 1 Mbit/s)"
        else:  # some motors reply, so the channel works
            check = "its cable and plugs, switch the power off and on, and see whether it has another id: "
            check += "yam-doctor says more"
        raise MotorError(
            f"{chain.channel}: no answer from {len(missing)} of {len(chain)} motors: {names}. Check {check}"
            + (f"; unexpected answers came from {strangers}: a motor may have another MST_ID" if strangers else "")
        )
    # If two motors share an id, the second reply arrives after `refresh` has returned.
    chain.clock.sleep(_DUPLICATE_WAIT_S)
    chain.drain()
    doubled = [
        f"{spec.name} (id {spec.can_id})"
        for spec, count in zip(chain.motors, chain.duplicates.tolist(), strict=True)
        if count
    ]
    if doubled:
        raise MotorError(
            f"{chain.channel}: more than one answer from {', '.join(doubled)}: two motors share an id, or "
            "another program drives this bus; give every motor its own id"
        )


def _answers_register(chain: MotorChain, motor: int) -> bool:
    try:
        chain.read_register(motor, Register.ESC_ID, timeout_s=0.02, attempts=1)
    except MotorError:
        return False
    return True
