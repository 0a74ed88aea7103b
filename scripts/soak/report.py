"""The table of a soak's figures."""

from collections.abc import Mapping
from typing import Any

Report = Mapping[str, Any]


def table(report: Report) -> str:
    """What was injected, how the arms answered, what the operator did, the largest values, the violations."""
    judge, caller = report["judge"], report["caller"]
    lines = [
        f"{report['minutes']:.1f} minutes, seed {report['seed']}, pace {report['pace']:g}: "
        f"{caller['counts'].get('ticks', 0)} ticks of the caller, {judge['records']} state records seen",
        "",
        "injected",
        *_counts(report["injected"]),
        f"  1 % of all frames lost all the time, either way; {report['left_over']} injections came too late",
        "",
        "policy outcomes (trouble, what the arm did)",
        *_counts({f"{trouble}: {mode.lower()}": count for trouble, mode, count in judge["outcomes"]}),
        "",
        "held back by the safety chain (times that it began)",
        *_counts(judge["limited"]),
        "",
        "obeyed (state records seen)",
        *_counts(judge["obeyed"]),
        "",
        *(["led at loop rate", *_counts(judge["coupled"]), ""] if judge["coupled"] else []),
        "set-points seeded from the measured pose",
        *_counts(judge["seeds"]),
        "",
        "operator and caller",
        *_counts(caller["counts"]),
        *_counts({f"error {name}": count for name, count in caller["errors"].items()}),
        "",
        "largest values seen (1 = the limit)",
        f"  set-point speed, of its limit                  {judge['largest_setpoint_speed_ratio']:.3f}",
        f"  set-point speed while landing                  {judge['largest_landing_speed_ratio']:.3f}",
        f"  joint speed by command, of 1.2 x its limit     {_largest(judge, 'speed')}",
        f"    ({judge['speed_windows']['in contact']} of {sum(judge['speed_windows'].values())} looks not judged: "
        "the arm touched something)",
        f"  motor torque, of its clip                      {_largest(judge, 'torque')}",
        f"  state against the truth, rad                   {_largest(judge, 'difference_rad')}",
        f"  way of a body after a cut elsewhere than landed {_largest(judge, 'moved_after_cut_m')} m",
        f"    ({judge['cuts_not_judged']} cuts not judged: seen too late)",
        f"  age of a returned state                        {caller['oldest_state_s'] * 1e3:.0f} of 250 ms",
        "",
        f"machine: stood still {judge['stalls']} times for more than 50 ms, "
        f"{judge['rig_slips']} slips of the rig; {judge['excused']} findings excused by that",
        f"left behind: {', '.join(report['left_behind']) or 'nothing'}",
        "",
        f"violations: {len(report['violations'])}",
    ]
    for row in report["violations"]:
        context = f"  [{', '.join(row['context'])}]" if row.get("context") else ""
        when = f"{row['at_s']:8.2f} s  after #{row['after_injection']}"
        lines.append(f"  {when}  {row['violation']}: {row['channel']}: {row['what']}{context}")
    return "\n".join(lines)


def _counts(counts: Mapping[str, int]) -> list[str]:
    width = max([len(name) for name in counts], default=0)
    return [f"  {name:<{max(width, 44)}} {count:>6}" for name, count in sorted(counts.items())] or ["  nothing"]


def _largest(judge: Report, name: str) -> str:
    row = judge["largest"][name]
    return f"{row['value']:.3f} {row['where']}".rstrip()
