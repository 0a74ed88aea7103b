"""The desktop window without a window: its model, its poses, its key, and an arm that is dragged by its tool."""

import contextlib
import io
import time

import mujoco
import numpy as np
import pytest

from lerobot_robot_yam.arm.collision.workspace import WorkspaceConfig
from lerobot_robot_yam.arm.config import ArmConfig
from lerobot_robot_yam.arm.kinematics import YamKinematics, pose_errors
from lerobot_robot_yam.arm.resolved_arm import ResolvedArm
from lerobot_robot_yam.commands.pages.view import main
from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.rig.control import running_rig
from lerobot_robot_yam.session.arm_session import ArmSession
from lerobot_robot_yam.state.emergency_stop import EmergencyStop
from lerobot_robot_yam.state.modes import Mode
from lerobot_robot_yam.viewer.desktop_window import Desktop, DesktopScene, DragControl, need_display
from tests.support.rigged import lockstep_rig, session_on, sim_config

FOLLOWER = "follower_left"
Q = np.array([0.3, 0.9, 0.8, -0.3, 0.2, 0.4])
SPACE = 32

rig = lockstep_rig(FOLLOWER)


def arm_of(name="left", **fields):
    return ResolvedArm(ArmConfig(name=name, channel=name, **fields))


@pytest.fixture
def session(rig):
    """A follower in the air; it is thrown away."""
    rig.set_pose(FOLLOWER, Q, 0.5)
    session = session_on(rig, sim_config(rig, FOLLOWER))
    session.start()
    yield session
    session.discard()


@pytest.fixture
def dragged(session):
    """(session, control, scene) of an arm that can be dragged."""
    control = DragControl(session, [FOLLOWER])
    return session, control, DesktopScene({key: session.hardware(FOLLOWER) for key in control.keys}, control.keys)


class Person(io.StringIO):
    """At a terminal."""

    def isatty(self):
        return True


def rounds(session, control, scene, seconds):
    """What the window does, for a while."""
    for _ in range(round(seconds / 0.02)):
        state = session[FOLLOWER].observe()
        (key,) = control.keys
        scene.show(key, state.q, state.gripper)
        scene.refresh()
        control.update(scene)
        session.clock.sleep(0.02)


@pytest.mark.parametrize(
    "arm, gripper",
    [("yam", "linear_4310"), ("yam", "crank_4310"), ("big_yam", "no_gripper"), ("yam", "yam_teaching_handle")],
)
def test_an_arm_stands_as_its_kinematics_say(arm, gripper):
    hardware = arm_of(arm=arm, gripper=gripper)
    scene, q = DesktopScene({"a": hardware}), Q[: hardware.joints]
    scene.show("a", q, 0.5)
    scene.refresh()
    assert max(pose_errors(scene.tool("a"), YamKinematics(hardware.arm, hardware.gripper).fk(q))) < 1e-6


def test_arms_stand_apart_or_where_their_configs_say():
    there = arm_of("right", workspace=WorkspaceConfig(base_position_m=[0.5, 0.2, 0.1], base_yaw_rad=1.0))
    scene = DesktopScene({"a": arm_of(), "b": arm_of(), "c": there})
    tools = []
    for key in "abc":
        scene.show(key, Q)
        scene.refresh()
        tools.append(scene.data.site(f"{key}/tcp_site").xpos.copy())
        assert max(pose_errors(scene.tool(key), scene.tool("a"))) < 1e-6
    assert tools[0][1] - tools[1][1] > 0.3 and tools[2][2] - tools[0][2] == pytest.approx(0.1)


def test_fingers_open():
    scene, hardware = DesktopScene({"a": arm_of()}), arm_of()
    fingers = [scene.model.joint(f"a/{name}").qposadr[0] for name in hardware.gripper.finger_joints]
    for opening, end in ((0.0, 0), (1.0, 1), (float("nan"), 0), (7.0, 1), (None, 0)):
        scene.show("a", np.full(6, np.nan), opening)
        assert scene.data.qpos[fingers] == pytest.approx(hardware.gripper.finger_range_m[end])
    assert np.isfinite(scene.data.qpos).all()


def test_a_scene_without_arms_and_a_grip():
    assert DesktopScene({}).model.nq == 0
    scene, pose = DesktopScene({"a": arm_of()}, ["a", "gone"]), np.eye(4)
    pose[:3, 3] = [0.3, 0.1, 0.2]
    scene.put_grip("a", pose)
    assert max(pose_errors(scene.grip("a"), pose)) < 1e-9
    grip = scene.model.body("drag a")
    assert scene.model.nmocap == 1 and not scene.model.geom_contype[grip.geomadr[0]]


@pytest.mark.parametrize("gripper", ["linear_4310", "linear_3507", "crank_4310", "flexible_4310", "no_gripper"])
def test_the_box_at_a_tool_can_be_clicked_from_all_sides(gripper):
    scene = DesktopScene({"a": arm_of(gripper=gripper)}, ["a"])
    scene.show("a", Q, 1.0)
    scene.refresh()
    scene.put_grip("a", scene.tool("a"))
    scene.refresh()
    site, seen = scene.data.site("a/tcp_site"), np.empty(1, np.int32)
    for side in site.xmat.reshape(3, 3).T[:2]:
        for eye in (side, -side):
            mujoco.mj_ray(scene.model, scene.data, site.xpos + 0.2 * eye, -eye, None, 1, -1, seen)
            assert seen[0] == scene.model.body("drag a").geomadr[0], scene.model.geom(seen[0]).name


def test_it_watches_until_it_is_told_to_control(dragged):
    session, control, scene = dragged
    before = session[FOLLOWER].observe().setpoint_q
    rounds(session, control, scene, 0.2)
    (key,) = control.keys
    aimed = YamKinematics("yam", "linear_4310").fk(session[FOLLOWER].observe().setpoint_q)  # an arm sags from there
    assert max(pose_errors(scene.grip(key), aimed)) < 1e-6
    away = scene.grip(key)
    away[2, 3] += 0.05
    scene.put_grip(key, away)  # a box that is dragged while watching goes back
    rounds(session, control, scene, 0.2)
    assert np.abs(session[FOLLOWER].observe().setpoint_q - before).max() < 0.01
    assert pose_errors(scene.grip(key), away)[0] > 0.03 and session[FOLLOWER].mode() is Mode.HOLD


def test_a_tool_goes_where_it_is_dragged_and_holds_then(dragged):
    session, control, scene = dragged
    (key,) = control.keys
    rounds(session, control, scene, 0.1)
    control.toggle()
    assert control.on
    rounds(session, control, scene, 0.3)
    start = scene.tool(key)
    for _ in range(25):  # 5 cm in half a second
        pose = scene.grip(key)
        pose[2, 3] += 0.002
        scene.put_grip(key, pose)
        rounds(session, control, scene, 0.02)
    rounds(session, control, scene, 0.7)
    moved = scene.tool(key)[:3, 3] - start[:3, 3]
    assert np.allclose(moved, [0.0, 0.0, 0.05], atol=0.01) and session[FOLLOWER].mode() is Mode.TRACK
    control.toggle()
    rounds(session, control, scene, 0.2)
    assert not control.on and session[FOLLOWER].mode() is Mode.HOLD


def test_the_emergency_stop_ends_control_and_says_so(dragged):
    session, control, scene = dragged
    rounds(session, control, scene, 0.1)
    control.toggle()
    rounds(session, control, scene, 0.1)
    EmergencyStop().latch("a test")
    try:
        rounds(session, control, scene, 0.2)
        assert not control.on and "STOPPED" in control.said
        control.toggle()
        assert not control.on and "takes no targets" in control.said
    finally:
        EmergencyStop().release()
    rounds(session, control, scene, 0.2)
    control.toggle()
    assert control.on and not control.said


@pytest.mark.long
@pytest.mark.alone
def test_arms_of_others_come_and_go():
    with running_rig(arms=[FOLLOWER]) as rig, contextlib.closing(Desktop()) as desktop:
        assert desktop.texts() == ("watching", "no arm runs on this computer") and desktop.scene.model.nq == 0
        session = ArmSession([sim_config(rig, FOLLOWER)])
        session.start()
        try:
            time.sleep(0.6)
            assert desktop.look() and not desktop.look()
            desktop.type(SPACE)  # which it may not heed: the arm is somebody else's
            desktop.update()
            (key,) = desktop._shown
            fk = YamKinematics("yam", "linear_4310").fk(session[FOLLOWER].observe().q)
            assert pose_errors(desktop.scene.tool(key), fk)[0] < 0.01
            assert desktop.texts() == ("watching", "") and session[FOLLOWER].mode() is Mode.HOLD
        finally:
            session.stop()
        time.sleep(0.6)
        assert desktop.look() and desktop.scene.model.nq == 0


@pytest.mark.long
@pytest.mark.alone
def test_space_drives_an_arm_of_its_own():
    with running_rig(arms=[FOLLOWER]) as rig:
        session = ArmSession([sim_config(rig, FOLLOWER)])
        session.start()
        try:
            control = DragControl(session, [FOLLOWER])
            with contextlib.closing(Desktop(control)) as desktop:
                (key,) = desktop._shown
                desktop.update()
                desktop.type(SPACE)
                start = desktop.scene.grip(key)
                for _ in range(50):
                    desktop.update()
                    assert control.on, control.said
                    pose = desktop.scene.grip(key)
                    pose[2, 3] = min(pose[2, 3] + 0.002, start[2, 3] + 0.03)
                    desktop.scene.put_grip(key, pose)
                    desktop.look()
                    time.sleep(0.02)
                assert desktop.texts()[0] == "CONTROL" and session[FOLLOWER].mode() is Mode.TRACK
                assert desktop.scene.tool(key)[2, 3] - start[2, 3] > 0.015
                desktop.type(SPACE)
                desktop.update()
                time.sleep(0.1)
                assert session[FOLLOWER].mode() is Mode.HOLD and desktop.texts()[0] == "watching"
        finally:
            session.stop()


def test_the_question_says_that_a_collision_margin_is_set(monkeypatch, capsys):
    monkeypatch.setattr("lerobot_robot_yam.viewer.desktop_window.need_display", lambda: None)
    monkeypatch.setattr("sys.stdin", Person("no"))
    assert main(["--desktop", "--channel", FOLLOWER, "--rig", "none", "--gripper", "linear_4310"]) == 1
    told, asked, after = capsys.readouterr().err.partition("Type drive to go on:")
    assert "yam-view sets 20 mm" in told and asked and "nothing was energised" in after


def test_without_a_display(monkeypatch, capsys):
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    assert main(["--desktop"]) == 1
    said = capsys.readouterr().err
    assert "--desktop needs a screen" in said and "browser" in said


def test_a_display_is_looked_for_first(monkeypatch):
    monkeypatch.setattr("glfw.init", lambda: False)
    with pytest.raises(ConfigError, match="needs a screen"):
        need_display()
