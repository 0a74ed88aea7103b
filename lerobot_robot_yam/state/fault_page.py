"""Page of the fault tables: `python -m lerobot_robot_yam.state.fault_page > docs/faults.md`."""

import sys
from collections.abc import Mapping
from typing import Any

from lerobot_robot_yam.state.faults import MEANING, RESPONSES, STALE_OVERSHOOT_RAD_S, Rule, stale_overshoot_rad_s
from lerobot_robot_yam.state.link_faults import LINK_RESPONSES


def _table(rules: Mapping[Any, Rule]) -> list[str]:
    """Return the lines of a Markdown table with one row per fault."""
    lines = [
        "| fault | noticed by | the arm | its peer | the caller sees | within | to re-arm |",
        "|---|---|---|---|---|---|---|",
    ]
    for fault, rule in rules.items():
        cells = (fault, rule.sign, rule.arm, rule.peer, rule.caller, f"{rule.within_s:g} s", rule.rearm)
        lines.append("| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |")
    return lines


def document() -> str:
    """Return the page as Markdown."""
    lines = [
        "# What happens when something fails",
        "",
        "One row for each fault: how it is noticed, what the arms do, and how an arm is brought back.",
        "",
        "Under a LeRobot command most faults end the command with an error, and the arms that can still be reached",
        "land. Repair the cause and start the command again: that is what *connect again* means. *Re-arming* enables",
        "the failed motors again while the others hold. It is for programs of your own: `robot.rearm()`.",
        "",
        "The arm is the one concerned, the peer is the other arm of the same robot. The caller is the program that",
        "drives the arms, such as `lerobot-record`. *Within* is the longest time from the fault to what the arm does.",
        "Bring-up is the start, when an arm is energised. An arm that is already landing when the fault comes goes on",
        "landing with the motors that still obey. If these cannot fold it, it sinks slowly onto what it meets.",
        "",
        "| an arm | means |",
        "|---|---|",
        *(f"| {response} | {meaning} |" for response, meaning in MEANING.items()),
        "",
        *_table(RESPONSES),
    ]
    lines += [
        "",
        "When power fails, or control process and stand-by are both killed, nothing commands the motors. 0.4 s",
        "later their own watchdog ends torque and the arm falls. Only mechanics can help then.",
        "",
        "While the emergency stop is latched, nothing lands: followers hold and leaders float. The loop goes on",
        "commanding them after its caller has gone, and `yam-estop release` then lands them at once. A leader that",
        "floats away by itself, lands, or is known not to be in balance, is held.",
        "",
        "Re-arming asks every motor at least three times where it is. It is refused",
        "",
        "- while motors answer more often than they are asked: a second arm is on the channel, and nobody knows whose",
        "  answers are right,",
        "- while a motor that has kept its torque reads where its joint cannot be, or works with another torque than",
        "  its command gives there (by 15 % of its range: a joint that was pushed away pulls back),",
        "- while the answers of a motor contradict each other: one of them may be garbled. A joint without torque",
        "  that swings against its stop looks so, too: wait until it hangs still.",
        "",
        "A motor obeys its last command until the next one comes, or for 0.4 s. A joint whose last command accelerated",
        f"it exceeds its speed limit by up to {STALE_OVERSHOOT_RAD_S} rad/s (arm stretched out). After a tick that is",
        f"late by 10 ms, it exceeds it by up to {stale_overshoot_rad_s(0.01):g} rad/s. With",
        "`teleop_speed: fast` both are up to twice that.",
        "",
        "## Arms of another computer",
        "",
        "The arms are the host's, and what the table above says happens there as with local ones. These faults come",
        "on top ([two machines](two-machines.md)). Both arms of a robot do the same. When the workstation's program",
        "dies, leaders land, too, even one that a person is holding. Local leaders do the same.",
        "",
        *_table(LINK_RESPONSES),
        "",
        "## For maintainers",
        "",
        "`scripts/run python -m lerobot_robot_yam.state.fault_page > docs/faults.md` writes this page from the table",
        "that the control loop obeys.",
    ]
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    sys.stdout.write(document())
