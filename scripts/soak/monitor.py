"""Judge of the soak, in a separate process: reads most state records, and gets the true state from the rig.

The process reads one JSON object from standard input (rig, arms by channel), prints one JSON object per violation, and
prints the summary when standard input ends. It learns about injected faults only from the rig's event log.
"""

import json
import select
import sys
import time
from collections import Counter
from typing import Any

from lerobot_robot_yam.rig.control import RigControl
from lerobot_robot_yam.state.emergency_stop import EmergencyStop
from lerobot_robot_yam.state.faults import Trouble
from lerobot_robot_yam.system.realtime import request_realtime
from soak.arm import Arm
from soak.checks import Finding, PolicyCheck
from soak.context import Context
from soak.coupled import CouplingCheck
from soak.obedience import ObedienceCheck
from soak.stalls import ProcessorWatch
from soak.truth import Truth

_PERIOD_S = 0.004
_RIG_PERIOD_S = 0.2
_REMEMBERED_S = 180.0  # time for which an injected fault may still be a cause, s
# Findings excused after the machine has stalled, which alone explains them. Other findings are judged by their stamps.
_EXCUSABLE = frozenset(
    {
        "no communication loss but where the link was cut",
        "the other arm as the policy says",
        "no trouble without a cause",
        "a lost motor is noticed",
        "joint speed",
        "torque clip",
        "the state is true",
        "an emergency stop stops",
        "a silent caller's arm holds",
    }
)


class Monitor:
    """Checks one rig until standard input ends."""

    def __init__(self, job: dict[str, Any]):
        self._arms = {channel: Arm(channel, row) for channel, row in job["arms"].items()}
        robots = {tuple(sorted((channel, arm.peer))) for channel, arm in self._arms.items()}
        self._context = Context(list(self._arms), sorted(robots))
        self._rig = RigControl(job["rig"], hold=False)
        self._truth = Truth(self._rig, self._arms, self._context)
        self._policy = PolicyCheck({channel: arm.peer for channel, arm in self._arms.items()})
        self._obedience = {channel: ObedienceCheck(channel) for channel in self._arms}
        self._leaders = {arm.leads: arm for arm in self._arms.values() if arm.leads is not None}
        self._coupling = {channel: CouplingCheck(channel) for channel in self._leaders}
        self._stop = EmergencyStop()
        self._stopped_since_s: float | None = None
        self._next_event = 0
        self._news: list[tuple[float, str, Trouble, float]] = []
        self._violations = self._excused = 0
        self._processors = ProcessorWatch()

    def run(self) -> None:
        """Check until standard input ends, then print the summary."""
        next_rig_s = time.monotonic()
        while True:
            if select.select([sys.stdin], [], [], _PERIOD_S)[0] and not sys.stdin.readline():
                break
            self._look()
            if time.monotonic() >= next_rig_s:
                next_rig_s = time.monotonic() + _RIG_PERIOD_S
                self._ask_rig()
        self._ask_rig()
        self._say(summary=self._summary())
        self._processors.close()
        for arm in self._arms.values():
            arm.close()
        self._rig.close()

    def _look(self) -> None:
        records = {channel: arm.read() for channel, arm in self._arms.items()}  # followers before their leaders
        if not self._stop.latched:  # read after the records, so that a released stop does not count for them
            self._stopped_since_s = None
        elif self._stopped_since_s is None:
            self._stopped_since_s = time.monotonic()
        for channel, record in records.items():
            if record is None:
                continue
            arm = self._arms[channel]
            for finding in self._obedience[channel].look(record, self._stopped_since_s):
                self._report(finding)
            for finding in arm.check.look(record):
                self._report(finding)
            if channel in self._coupling:
                for finding in self._coupling[channel].look(record, self._leaders[channel].record):
                    self._report(finding)
            findings, news = self._policy.look(channel, record, self._arms[arm.peer].record)
            for finding in findings:
                self._report(finding)
            if news is not None:
                self._news.append((float(record["stamp_s"]), channel, *news))

    def _ask_rig(self) -> None:
        for since_s, until_s in self._processors.news():
            self._context.stalled(since_s, until_s)
        self._truth.look()
        for event in self._rig.events(self._next_event):
            self._next_event = event["number"] + 1
            for at_s, channel, motor in self._context.take(event):
                self._report(
                    Finding("no communication loss but where the link was cut", at_s, channel, f"{motor} reports 0xD")
                )
            self._truth.take(event)
        for finding in [*self._truth.judge(), *self._truth.judge_seeds()]:
            self._report(finding)
        for at_s, channel, trouble, since_s in self._news:  # an arm may obstruct itself: OBSTRUCTED needs no injection
            explained = self._context.explained(channel, trouble, at_s, at_s - since_s)
            if trouble is not Trouble.OBSTRUCTED and not explained:
                self._report(Finding("no trouble without a cause", at_s, channel, f"{trouble}"))
        self._news.clear()
        self._context.forget_before(time.monotonic() - _REMEMBERED_S)

    def _report(self, finding: Finding) -> None:
        if finding.invariant in _EXCUSABLE and self._context.stood_still(finding.at_s - 0.6, finding.at_s + 0.01):
            self._excused += 1
            return
        self._violations += 1
        arm = self._arms[finding.channel]
        context = [f"{c.kind} #{c.number}" for c in self._context.arms[finding.channel].causes[-4:]]
        mode = None if arm.record is None else int(arm.record["mode"])
        self._say(
            violation=finding.invariant,
            at_s=finding.at_s,
            channel=finding.channel,
            what=finding.what,
            after_injection=self._context.position,
            mode=mode,
            context=context,
            history=arm.history(finding.at_s),
        )

    def _say(self, **fields: Any) -> None:
        sys.stdout.write(json.dumps(fields) + "\n")
        sys.stdout.flush()

    def _summary(self) -> dict[str, dict[str, Any]]:
        """Return figures by title and name."""
        checks = [arm.check for arm in self._arms.values()]
        found = {
            "seen": {
                "state records": sum(arm.records for arm in self._arms.values()),
                "violations": self._violations,
                "findings excused, since the machine stood still": self._excused,
                "times that it stood still for more than 50 ms": self._context.stalls,
                "slips of the rig": self._rig.stats()["slips"],
                "cuts of torque seen too late to judge": self._truth.unjudged_cuts,
            },
            "policy outcomes": {f"{trouble}: {mode}": n for (trouble, mode), n in self._policy.outcomes.items()},
            "obeyed": {
                "records in an emergency stop": sum(check.stops for check in self._obedience.values()),
                "records of a silent caller's arm": sum(check.silences for check in self._obedience.values()),
            },
            "largest": {
                "set-point speed, of its limit": max(check.largest_ratio for check in checks),
                "set-point speed while landing": max(check.largest_landing_ratio for check in checks),
                **self._truth.largest,
            },
        }
        if self._coupling:
            gates: Counter[str] = sum((check.gates for check in self._coupling.values()), Counter())
            found["led at loop rate"] = {
                "records of a coupled follower": sum(check.records for check in self._coupling.values()),
                "gaps that began in a record that is missing": sum(check.unseen for check in self._coupling.values()),
                **{f"gate became {name}": count for name, count in gates.items()},
            }
        return found


def main() -> int:
    """Run the monitor process; return the exit status."""
    monitor = Monitor(json.loads(sys.stdin.readline()))
    request_realtime(1)
    sys.stdout.write(json.dumps({"ready": True}) + "\n")
    sys.stdout.flush()
    monitor.run()
    return 0


if __name__ == "__main__":
    sys.exit(main())
