"""Commands that repair a motor or a handle. The doctor prints them; it never changes anything."""

from collections.abc import Mapping

from lerobot_robot_yam.damiao.registers import Register
from lerobot_robot_yam.damiao.tables import TIMEOUT_COUNT_S
from lerobot_robot_yam.doctor.kit.targets import Target


def set_registers(target: Target, motor_id: int, values: Mapping[Register, float]) -> str:
    """Set registers of a motor and store them."""
    where = target.config.on_command_line
    if not values.keys().isdisjoint({Register.ESC_ID, Register.MST_ID}):
        return f"yam-motors set-id {where} {motor_id} {int(values.get(Register.ESC_ID, motor_id))}"
    if Register.TIMEOUT in values:
        return f"yam-motors timeout {where} --motor {motor_id} {values[Register.TIMEOUT] * TIMEOUT_COUNT_S:g}"
    settings = " ".join(f"{register.name}={value:.9g}" for register, value in values.items())
    return f"yam-motors write {where} --motor {motor_id} {settings} --store"


def report_on_request(target: Target) -> str:
    """Let the handle report only when it is asked."""
    return f"yam-handle report {target.config.on_command_line} 0"


def zero_trigger(target: Target) -> str:
    """Take the trigger's present position as zero."""
    return f"yam-handle zero {target.config.on_command_line}"
