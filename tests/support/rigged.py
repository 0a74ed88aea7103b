"""Virtual rigs, live or in lock-step, and arms on them, configured as what they are."""

import contextlib

import numpy as np
import pytest

from lerobot_robot_yam.arm.config import ArmConfig
from lerobot_robot_yam.mobile.base_config import BaseConfig
from lerobot_robot_yam.rig.control import running_rig
from lerobot_robot_yam.rig.lockstep.lockstep_rig import LockstepRig
from lerobot_robot_yam.session.arm_session import ArmSession
from lerobot_robot_yam.session.yam_arm import YamArm
from lerobot_robot_yam.system.clock import SYSTEM

LIVE = pytest.param("live", marks=[pytest.mark.long, pytest.mark.alone])
STOPS = [3.25, -3.3]  # of the gripper in the default scene: nothing has to be searched


@contextlib.contextmanager
def rig_of(kind, **options):
    """A rig, "lockstep" or "live", with these options of its scene."""
    if kind == "live":
        with running_rig(**options) as rig:
            yield rig
    else:
        with contextlib.closing(LockstepRig(**options)) as rig:
            yield rig


def either_rig(*arms):
    """A fixture: a rig in lock-step, and in the long tier also a live one."""

    @pytest.fixture(params=["lockstep", LIVE])
    def rig(request):
        with rig_of(request.param, arms=list(arms)) as rig:
            yield rig

    return rig


def lockstep_rig(*arms, **options):
    """A fixture: a rig in lock-step."""

    @pytest.fixture
    def rig():
        with rig_of("lockstep", arms=list(arms), **options) as rig:
            yield rig

    return rig


def running_arm(channel):
    """A fixture: a session of one arm of the rig, under way."""

    @pytest.fixture
    def session(rig):
        session = session_on(rig, sim_config(rig, channel))
        session.start()
        yield session
        session.discard()

    return session


def sim_config(rig, channel, **fields):
    """A follower that holds or a leader that floats, weighing what the model says."""
    interface = "yam_lockstep" if isinstance(rig, LockstepRig) else "yam_sim"
    fields = {"gravity_factor": [1.0] * 6, "interface": interface} | fields
    if channel.startswith("leader"):
        fields = {"gripper": "yam_teaching_handle", "start": "float"} | fields
    else:
        fields = {"gripper_stops_rad": STOPS} | fields
    return ArmConfig(name=channel, channel=channel, can_options={"rig": rig.name}, **fields)


def base_on(rig, **fields):
    """The configuration of the base of a rig."""
    interface = "yam_lockstep" if isinstance(rig, LockstepRig) else "yam_sim"
    return BaseConfig(channel="base", interface=interface, can_options={"rig": rig.name}, **fields)


def isolation_of(rig):
    """Where the control loop of arms on that rig runs."""
    return "lockstep" if isinstance(rig, LockstepRig) else "process"


def arm_on(rig, channel, **fields):
    """One arm, not yet connected."""
    return YamArm(sim_config(rig, channel, **fields), isolation=isolation_of(rig))


def session_on(rig, *configs):
    """A session, not yet started."""
    return ArmSession(configs, isolation_of(rig))


def leave(rig, session):
    """End a session: at once on a rig in lock-step, which is thrown away; on a live one its arms land."""
    if isinstance(rig, LockstepRig):
        session.discard()
    else:
        session.stop()


def exchange(chain, commands, timeout_s=0.004):
    """One tick of motors that no loop runs; whether all have answered."""
    chain.send(commands)
    return chain.collect(chain.clock.now() + timeout_s)


def energise(controller, in_between=None):
    """Energise an arm that no loop runs; `in_between` is called once, after the first tick. Fails as a loop does."""
    arm = controller.actuation
    try:
        for _ in controller.bring_up.energise():
            arm.send()
            controller.interface.receive(controller.clock.now() + 0.004)
            if in_between is not None:
                in_between()
                in_between = None
    except Exception:
        abandon(controller)
        raise


def abandon(controller):
    """Cut the torque of an arm that no loop runs."""
    controller.abandon()
    while controller.status.letting_go:
        controller.send()
        controller.collect(controller.clock.now() + 0.004)
        controller.measure(controller.clock.now())


@contextlib.contextmanager
def arm_that_stays_up(rig, channel, **fields):
    """One connected arm, for a test that is over before it lands."""
    arm = arm_on(rig, channel, **fields).connect()
    try:
        yield arm
    finally:
        leave(rig, arm._session)


def pause(rig, seconds):
    """Let time pass on a rig while no session runs on it."""
    (rig if isinstance(rig, LockstepRig) else SYSTEM).sleep(seconds)


def carry(rig, clock, channel, q):
    """A hand that brings an arm to a pose (n,), at 0.5 rad/s at most: no joint leaps."""
    start = np.array(rig.state()["arms"][channel]["q"])[: len(q)]
    steps = int(np.ceil(np.abs(np.array(q) - start).max() / 0.002))
    way = np.array(q) - start
    for step in range(1, steps + 1):
        speed = way / steps / 0.004 if step < steps else np.zeros(len(q))
        rig.set_pose(channel, (start + way * step / steps).tolist(), dq=speed.tolist())
        clock.sleep(0.004)


def track(session, poses, seconds, gripper=0.5, **gains):
    """Stream one pose (6,) per arm, maybe with kp and kd."""
    clock = session.clock
    deadline = clock.now() + seconds
    while clock.now() < deadline:
        for name, pose in poses.items():
            session[name].write_target(pose, gripper, **gains)
        clock.sleep(0.02)
