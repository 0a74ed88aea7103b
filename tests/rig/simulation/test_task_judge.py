"""The judge of tasks, on made-up histories of the world."""

from dataclasses import replace

import numpy as np
import pytest

from lerobot_robot_yam.rig.scene.tasks import Task
from lerobot_robot_yam.rig.simulation.judge import TaskJudge, View
from lerobot_robot_yam.system.strict_yaml import parse

LEFT, RIGHT = "follower_left", "follower_right"
PAD = np.array([0.3, 0.1, 0.0])
LIFT = {"prop": "cube", "lifted_m": 0.05}
REST = {
    "prop": "cube",
    "inside": {"frame": "pad", "center_m": [0, 0, 0.02], "radius_m": 0.03},
    "released": True,
    "still": True,
    "for_s": 0.3,
}


def view(t=0.0, at=(0.3, 0.3, 0.02), speed=0.0, touching=("table",), held=(), drawer=0.0, pad_yaw=0.0) -> View:
    c, s = np.cos(pad_yaw), np.sin(pad_yaw)
    turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    return View(
        sim_s=10.0 + t,
        frames={"cube": (np.array(at), np.eye(3)), "pad": (PAD, turn)},
        speeds={"cube": speed},
        joints={"drawer": drawer},
        touching={"cube": frozenset(touching)},
        held={"cube": frozenset(held)},
    )


def judge(*stages, begin: View | None = None) -> TaskJudge:
    row = {"name": "try", "description": "Try.", "time_limit_s": 8.0, "success": list(stages)}
    return TaskJudge(parse(Task, row, "try"), frozenset({LEFT, RIGHT}), begin or view())


def shown(judge: TaskJudge, *views: View) -> list:
    """Kinds of all events, stages with their number."""
    events = [event for each in views for event in judge.update(each)]
    return [event["stage"] if event["kind"] == "task_stage" else event["kind"] for event in events]


def resting(first: float, last: float, **what) -> list[View]:
    return [view(t, **{"at": (0.31, 0.12, 0.02), **what}) for t in np.arange(first, last, 0.05)]


LIFTED = view(1.0, at=(0.3, 0.3, 0.08), touching=(LEFT,))


def test_lifted_and_put_to_rest_at_the_goal_is_success():
    each = judge(LIFT, REST)
    assert shown(each, view(0.5), LIFTED, *resting(2.0, 3.0)) == [1, 2, "task_success"]
    assert each.success and not each.failed
    assert each.update(view(3.0, at=(0, 0, -1))) == []  # the verdict stands


def test_success_has_its_time():
    each = judge(LIFT, REST)
    events = [event for seen in (LIFTED, *resting(2.0, 3.0)) for event in each.update(seen)]
    assert events[-1] == {"kind": "task_success", "task": "try", "since_s": pytest.approx(2.3, abs=0.051)}


@pytest.mark.parametrize(
    "wrong",
    [
        {"at": (0.34, 0.1, 0.02)},  # beside the goal
        {"at": (0.3, 0.1, 0.04)},  # above it
        {"touching": ("table", RIGHT)},  # still touched
        {"speed": 0.05},  # rolls
    ],
)
def test_not_quite_is_not_success(wrong):
    each = judge(LIFT, REST)
    assert shown(each, LIFTED, *resting(2.0, 7.0, **wrong)) == [1]


def test_pushing_it_to_the_goal_is_not_success():
    assert shown(judge(LIFT, REST), *resting(1.0, 7.0)) == []


def test_a_lasting_condition_begins_anew_after_an_interruption():
    each = judge(REST)
    assert shown(each, *resting(0.0, 0.25), view(0.25), *resting(0.3, 0.55)) == []
    assert shown(each, *resting(0.55, 0.7)) == [1, "task_success"]


def test_a_goal_in_a_frame_turns_with_it():
    stage = {"prop": "cube", "inside": {"frame": "pad", "center_m": [0.1, 0, 0.02], "radius_m": 0.01}}
    assert shown(judge(stage), view(1.0, at=(0.4, 0.1, 0.02))) == [1, "task_success"]
    assert shown(judge(stage), view(1.0, at=(0.4, 0.1, 0.02), pad_yaw=np.pi / 2)) == []
    assert shown(judge(stage), view(1.0, at=(0.3, 0.2, 0.02), pad_yaw=np.pi / 2)) == [1, "task_success"]


HANDED = ({**LIFT, "held_by": LEFT}, {"prop": "cube", "held_by": RIGHT, "airborne": True})


def test_a_handover_in_the_air():
    up = replace(LIFTED, held={"cube": frozenset({LEFT})})
    both = replace(up, sim_s=12.0, held={"cube": frozenset({LEFT, RIGHT})}, touching={"cube": frozenset({LEFT, RIGHT})})
    assert shown(judge(*HANDED), LIFTED, up, both) == [1, 2, "task_success"]


def test_a_handover_by_way_of_the_table_begins_anew():
    up = replace(LIFTED, held={"cube": frozenset({LEFT})})
    down = view(2.0, touching=("table", LEFT), held=(LEFT,))
    taken = view(3.0, at=(0.3, 0.3, 0.09), touching=(RIGHT,), held=(RIGHT,))
    assert shown(judge(*HANDED), up, down, taken) == [1, 0]


def test_lying_on_the_table_is_no_setback_before_anything_is_reached():
    lying = [view(1.0 + 0.005 * tick, touching=("table",)) for tick in range(3)]
    assert shown(judge({**LIFT, "airborne": True}, REST), *lying) == []


def test_a_joint_has_to_stay_open():
    stage = {"joint": "drawer", "joint_range": [0.1, 0.15], "for_s": 0.3}
    assert shown(judge(stage), *(view(t, drawer=0.12) for t in (1.0, 1.2))) == []
    assert shown(judge(stage), view(1.0, drawer=0.12), view(1.31, drawer=0.11)) == [1, "task_success"]
    assert shown(judge(stage), view(1.0, drawer=0.12), view(1.2, drawer=0.05), view(1.4, drawer=0.12)) == []


def test_time_runs_out():
    each = judge(LIFT, REST)
    assert shown(each, LIFTED, view(8.0), view(8.01)) == [1, "task_failed"]
    assert each.failed and not each.success
    assert each.reason == "the time limit of 8 s has passed; 1 of 2 stages were reached"


def test_a_prop_beside_the_table_is_a_failure_at_once():
    each = judge(LIFT, REST)
    assert shown(each, view(1.0, at=(1, 1, -0.2)), *resting(2.0, 3.0)) == ["task_failed"]
    assert "cube fell off the table" in each.reason
