"""The controller's simulator: it does what the dry run has shown, in the same time, and refuses the same."""

import numpy as np
import pytest

from lerobot_robot_yam.errors import YamError
from lerobot_robot_yam.waldo.controller.motion import Command
from lerobot_robot_yam.waldo.program import swapped
from tests.support.waldo_desk import waldo_desk

MOVES = 5
PROGRAMS = [pytest.param(seed, marks=[pytest.mark.long] * (seed >= 20)) for seed in range(100)]
HOME = [0.0, 60.0, 60.0, -29.0, 0.0, 0.0]


@pytest.fixture
def desk():
    with waldo_desk() as desk:
        yield desk


@pytest.fixture
def dry_run(waldoctl):
    from lerobot_robot_yam.waldo.client.dry_run_client import DryRunClient

    return DryRunClient


def moves(numbers):
    """Random moves near home: joints, relative lines, poses, with speeds or durations."""
    pace = {"speed": numbers.uniform(0.3, 1.0), "accel": numbers.uniform(0.3, 1.0)}
    if numbers.random() < 0.3:
        pace = {"duration": numbers.uniform(2.0, 4.0)}
    if numbers.random() < 0.5:
        return "move_j", {"angles": (HOME + numbers.uniform(-35, 25, 6)).tolist(), **pace}
    if numbers.random() < 0.7:
        way = [*numbers.uniform(-30, 30, 3), *numbers.uniform(-8, 8, 3)]
        return "move_l", {"pose": way, "rel": True, "frame": numbers.choice(["WRF", "TRF"]).item(), **pace}
    return "home", {}


def refused(call, *arguments, **options):
    try:
        return call(*arguments, **options), False
    except YamError:
        return None, True


@pytest.mark.parametrize("seed", PROGRAMS)
def test_what_the_preview_shows_is_what_is_done(desk, dry_run, seed):
    numbers, dry, shown_s, took_s = np.random.default_rng(seed), dry_run(), 0.0, 0.0
    for _ in range(MOVES):
        name, arguments = moves(numbers)
        shown, not_shown = refused(getattr(dry, name), **arguments)
        index, not_done = refused(desk.ask, name, **arguments)
        assert not_shown == not_done
        if shown is not None:
            shown_s += shown.duration
            took_s += desk.carry_out(index)
    assert took_s == pytest.approx(shown_s, rel=0.03, abs=0.05)
    np.testing.assert_allclose(desk.ask("angles"), dry.angles(), atol=0.05)
    np.testing.assert_allclose(desk.ask("pose")[:3], dry.pose()[:3], atol=0.05)


def test_a_queue_of_moves_loses_no_time(desk):
    pause = desk.ask("delay", seconds=60.0)
    indices = [desk.ask("move_j", angles=[angle, *HOME[1:]], speed=0.5) for angle in (20, 0, 20, 0)]
    alone = desk.controller.motion.waiting[1].plan.duration_s
    desk.carry_out(pause)
    assert desk.carry_out(indices[-1]) == pytest.approx(4 * alone, abs=0.03)
    assert desk.ask("status")["completed_index"] == indices[-1]


def corner(desk, radius_mm):
    """Rows (k, 3) mm of the tool on two lines around a corner, and how long they took."""
    up, aside = {"pose": [0, 0, 60, 0, 0, 0], "rel": True}, {"pose": [0, 60, 0, 0, 0, 0], "rel": True}
    pause = desk.ask("delay", seconds=60.0)
    desk.ask("move_l", r=radius_mm, **up)
    last, rows = desk.ask("move_l", **aside), []
    desk.carry_out(pause)
    begun_s = desk.controller.now()
    while desk.controller.motion.end_of(last) is None:
        desk.run(0.01)
        rows.append(desk.ask("pose")[:3])
    return np.array(rows), desk.controller.now() - begun_s


def test_a_corner_is_rounded_within_its_radius(desk, dry_run):
    begin = np.array(desk.ask("pose")[:3])
    sharp, sharp_s = corner(desk, 0)
    desk.carry_out(desk.ask("home"))
    rounded, rounded_s = corner(desk, 20)
    there = begin + [0, 0, 60]
    nearest = [np.linalg.norm(rows - there, axis=1).min() for rows in (sharp, rounded)]
    assert nearest[0] < 0.5 < 1.0 < nearest[1] < 20.0 and rounded_s < sharp_s - 0.1
    np.testing.assert_allclose(rounded[-1], begin + [0, 60, 60], atol=0.05)
    dry = dry_run()
    assert dry.move_l([0, 0, 60, 0, 0, 0], rel=True, r=20) is None
    assert dry.move_l([0, 60, 0, 0, 0, 0], rel=True).duration == pytest.approx(rounded_s, abs=0.15)
    assert dry.flush() == []


def test_a_stop_in_a_rounded_corner_is_a_stop(desk):
    index = desk.ask("move_l", pose=[0, 0, 60, 0, 0, 0], rel=True, r=30)
    desk.ask("move_l", pose=[0, 60, 0, 0, 0, 0], rel=True)
    desk.carry_out(index)
    desk.ask("estop")
    desk.run(0.5)
    assert np.abs(desk.controller.motion.dq).max() < 1e-9 and desk.ask("queue") == []


def test_a_move_waits_until_a_jog_has_come_to_rest(desk):
    desk.ask("jog_j", joints=[0], speeds=[1.0], duration=1.0)
    desk.run(0.4)
    index = desk.ask("home")
    desk.carry_out(index)
    np.testing.assert_allclose(desk.ask("angles"), HOME, atol=1e-6)


def test_a_jog_is_refused_while_a_move_runs(desk):
    desk.ask("move_j", angles=[40, *HOME[1:]])
    desk.run(0.2)
    with pytest.raises(YamError, match="a queued command moves the arm"):
        desk.ask("jog_j", joints=[1], speeds=[0.5])


def test_what_was_planned_before_the_arm_was_stopped_or_moved_is_not_queued(desk):
    motion = desk.controller.motion
    plan, epoch = desk.controller.planner.joints(motion.q, motion.q + 0.2), motion.epoch
    desk.ask("jog_j", joints=[0], speeds=[0.5], duration=0.2)
    for _ in range(2):  # while it is jogged, and afterwards
        with pytest.raises(YamError, match="the arm was jogged meanwhile; give the command again"):
            motion.add(Command("move_j", plan=plan), epoch)
        desk.run(1.0)
    desk.ask("stop")
    with pytest.raises(YamError, match="the arm was stopped meanwhile; nothing moves"):
        motion.add(Command("move_j", plan=plan), epoch)


def test_checkpoints_and_pauses_take_their_turn(desk):
    desk.ask("delay", seconds=0.5)
    index = desk.ask("checkpoint", label="after")
    desk.run(0.3)
    assert desk.ask("status")["last_checkpoint"] == "" and desk.ask("queue") == ["delay 0.5 s", "checkpoint after"]
    assert desk.carry_out(index) == pytest.approx(0.2, abs=0.05)
    assert desk.ask("status")["last_checkpoint"] == "after"


def test_a_tool_takes_its_turn_and_a_move_waits_for_the_jaws(desk):
    desk.ask("select_tool", tool_name="linear_4310")
    desk.ask("tool_action", tool_key="LINEAR_4310", action="close")
    index = desk.ask("move_j", angles=[10, *HOME[1:]])
    desk.run(0.2)
    np.testing.assert_allclose(desk.ask("angles"), HOME, atol=1e-6)
    desk.carry_out(index)
    assert desk.ask("status")["tool"]["positions"] == [1.0]


def test_the_sense_of_the_gripper_is_swapped_at_both_ends():
    assert (swapped(0.0), swapped(1.0), swapped(swapped(0.3))) == (1.0, 0.0, pytest.approx(0.3))


@pytest.mark.parametrize(
    "name, arguments, words",
    [
        ("select_profile", {"profile": "TOPPRA"}, "no motion profile 'TOPPRA'; there is ruckig"),
        ("select_tool", {"tool_name": "SPOON"}, "no tool 'SPOON'; this arm has NONE, LINEAR_4310"),
        ("connect_hardware", {"port_str": ""}, "the channel is chosen at the arm's computer"),
        ("simulator", {"enabled": False}, "this controller has no hardware; start the controller with --hardware"),
        ("tool_action", {"tool_key": "LINEAR_4310", "action": "spin"}, "an action is open, close or move"),
        ("tool_action", {"tool_key": "LINEAR_4310", "action": "move", "params": [2]}, r"0 \(open\) to 1 \(closed\)"),
        ("delay", {"seconds": -1}, "a delay takes 0 to 600 s"),
        ("set_payload", {"mass": -1}, "payload_mass_kg"),
        ("set_shapes", {"shapes": [{"name": "a"}]}, "needs three extents above zero"),
        ("move_j", {"angles": [0] * 6, "pose": [0] * 6}, "takes angles, or pose=, and not both"),
        ("move_j", {"spin": 1}, "move_j: wrong arguments"),
        ("arm", {}, "the controller knows no request 'arm'"),
    ],
)
def test_a_refusal_says_why_and_changes_nothing(desk, name, arguments, words):
    before = desk.ask("status")
    with pytest.raises(YamError, match=words):
        desk.ask(name, **arguments)
    after = desk.ask("status")
    assert (before["angles"], before["tool"], before["scene_epoch"]) == (
        after["angles"], after["tool"], after["scene_epoch"],
    )  # fmt: skip


def test_shapes_are_kept_clear_of(desk):
    post = {"name": "post", "center_m": [0.2, 0.2, 0.3], "size_m": [0.1, 0.1, 0.6]}
    desk.ask("set_shapes", shapes=[post])
    with pytest.raises(YamError, match="would come too near to keep-out 'post'"):
        desk.ask("move_j", angles=[90, *HOME[1:]])
    assert desk.ask("status")["scene_epoch"] == 1 and desk.ask("shapes") == [post]
    desk.ask("reset_state")
    desk.carry_out(desk.ask("move_j", angles=[90, *HOME[1:]]))
    assert desk.ask("angles")[0] == pytest.approx(90.0)


def test_a_stop_on_a_line_leaves_the_tool_on_it(desk):
    desk.ask("teleport", angles_deg=HOME)
    desk.run(0.1)
    planner, motion = desk.controller.planner, desk.controller.motion
    begin, way = planner.pose(motion.q)[:3, 3], np.array([60.0, 100.0, -60.0])
    desk.ask("move_l", pose=[*way, 0, 0, 0], rel=True, speed=1.0)
    desk.run(0.4)
    desk.ask("estop")
    moved = []
    for _ in range(40):
        desk.run(0.01)
        moved.append(planner.pose(motion.q)[:3, 3] - begin)
    along = way / np.linalg.norm(way)
    assert np.linalg.norm(np.cross(moved, along), axis=1).max() < 5e-4
    assert 0.02 < np.linalg.norm(moved[-1]) < 0.12 and not motion.dq.any()


def test_a_preview_that_is_put_elsewhere_goes_on_from_there(dry_run):
    dry, elsewhere, there = dry_run(), [30.0, *HOME[1:]], [40.0, *HOME[1:]]
    dry.select_tool("LINEAR_4310")
    assert dry.move_l([0, 0, 60, 0, 0, 0], rel=True, r=20) is None  # a corner to round, which never comes
    dry.teleport(elsewhere, [1.0])
    np.testing.assert_allclose(
        np.degrees(dry.move_j(there).joint_trajectory_rad[[0, -1]]), [elsewhere, there], atol=0.01
    )
    np.testing.assert_allclose(dry.angles(), there, atol=0.01)
    assert dry.tool.close().duration < 0.01 < dry.tool.open().duration


@pytest.mark.parametrize("position", [2.0, -0.1, float("nan")])
def test_the_preview_refuses_what_the_jaws_cannot_do_in_the_words_of_the_controller(desk, dry_run, position):
    with pytest.raises(YamError) as previewed:
        dry_run().tool.set_position(position)
    with pytest.raises(YamError) as refused:
        desk.ask("tool_action", tool_key="LINEAR_4310", action="move", params=[position])
    assert str(previewed.value) == str(refused.value)


def test_the_preview_says_the_pose_in_a_frame_as_the_controller_does(desk, dry_run):
    for frame in ("WRF", "TRF"):
        np.testing.assert_allclose(dry_run().pose(frame), desk.ask("pose", frame=frame), atol=1e-6)
    with pytest.raises(YamError, match="there is no frame 'BASE'"):
        dry_run().pose("BASE")
