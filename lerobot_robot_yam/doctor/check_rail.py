"""Check of a base's rail: its board of switches and brake, and whether its height is known."""

from lerobot_robot_yam.control.mobile.rail_boards import open_checked
from lerobot_robot_yam.control.mobile.rail_calibration import load
from lerobot_robot_yam.doctor.kit.findings import Report
from lerobot_robot_yam.doctor.kit.targets import BaseTarget
from lerobot_robot_yam.errors import YamError
from lerobot_robot_yam.mobile.rail_profile import RAIL_MOTOR
from lerobot_robot_yam.system.clock import Clock


def inspect_rail(target: BaseTarget, clock: Clock, report: Report) -> None:
    """Open the board, which engages the brake, read the switches, and close it; the motors have been asked before."""
    section, where, rail = report["rails"], f"{target.channel} rail", target.config.rail
    assert rail is not None
    try:
        board, sample = open_checked(target.hardware, clock)
    except YamError as error:
        section.problem(where, str(error), "repair that, then press each switch by hand and run yam-doctor again")
        return
    board.close()
    known = load(target.config.name, rail.calibration_path, rail.stroke_m)
    rows = [row for row in report["motors"].rows if row["name"] == RAIL_MOTOR.name and "fault" in row]
    angles = [row["position_rad"] for row in rows if row["channel"] == target.channel]
    homed = known is not None and any(known.scale(rail.direction * q) for q in angles)
    row = {"channel": target.channel, "io": rail.io, "upper": sample.upper, "lower": sample.lower}
    section.rows.append({**row, "brake_on": sample.brake_on, "homed": homed})
    if not homed:
        section.note(
            where, "its height is not known, so it takes no targets", "home it: lerobot-calibrate, or home_rail()"
        )
