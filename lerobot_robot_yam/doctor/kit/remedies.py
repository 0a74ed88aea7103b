"""Commands that repair a motor or a handle. The doctor prints them; it never sends them."""

from collections.abc import Mapping

from lerobot_robot_yam.damiao.handle_encoder import REQUEST_ID, encode_report_frequency, encode_zero
from lerobot_robot_yam.damiao.registers import Register, encode_store, encode_write
from lerobot_robot_yam.damiao.tables import REGISTER_ID
from lerobot_robot_yam.doctor.kit.targets import Target


def set_registers(target: Target, motor_id: int, values: Mapping[Register, float]) -> str:
    """Set registers of a motor and store them. With ESC_ID among them, what follows goes to the new id."""
    frames = []
    for register, value in values.items():
        frames.append((REGISTER_ID, encode_write(motor_id, register, value)))
        if register is Register.ESC_ID:
            motor_id = int(value)
    frames.append((REGISTER_ID, encode_store(motor_id)))
    return _send(target, *frames)


def report_on_request(target: Target) -> str:
    """Let the handle report only when it is asked."""
    return _send(target, (REQUEST_ID, encode_report_frequency(0)))


def zero_trigger(target: Target) -> str:
    """Take the trigger's present position as zero."""
    return _send(target, (REQUEST_ID, encode_zero()))


def _send(target: Target, *frames: tuple[int, bytes]) -> str:
    """With can-utils on a real interface; on any other, the frames to send."""
    texts = [f"{identifier:03X}#{data.hex().upper()}" for identifier, data in frames]
    if target.real:
        return " && sleep 0.1 && ".join(f"cansend {target.channel} {text}" for text in texts)
    return f"send {', then '.join(texts)} on {target.channel}"
