"""A host takes commands of the client that has the arms, and nothing else: whatever else comes has no effect."""

import contextlib
import os
import random
import time

import numpy as np
import pytest
import zmq

from lerobot_robot_yam.errors import ChannelInUseError, ConfigError, LinkError
from lerobot_robot_yam.remote import link_messages as wire
from lerobot_robot_yam.remote.host_address import HostAddress
from lerobot_robot_yam.remote.host_question import Host, hello
from lerobot_robot_yam.remote.hosted_group import Phase
from lerobot_robot_yam.remote.link_keys import LinkKey, pair
from lerobot_robot_yam.remote.link_sockets import ClientSockets, HostSockets
from lerobot_robot_yam.rig.control import running_rig
from lerobot_robot_yam.state.emergency_stop import EmergencyStop
from lerobot_robot_yam.state.modes import Mode
from lerobot_robot_yam.state.records import COMMAND_DTYPE, Request
from lerobot_robot_yam.system.clock import SYSTEM
from lerobot_robot_yam.system.shared_block import SharedBlock
from tests.support.hosted import ServedArms
from tests.support.rigged import track

ARM = "follower_left"
POSE, FAR = [0.1, 0.2, 0.2, 0.0, 0.0, 0.1], [-0.8, 1.5, 1.5, 0.5, 0.5, 0.5]


@pytest.fixture(scope="module")
def served():
    with running_rig(arms=[ARM]) as rig, ServedArms(rig, ARM) as served:
        yield served


@pytest.fixture(scope="module")
def session(served):
    session = served.session()
    session.start()
    track(session, {ARM: POSE}, 0.5)
    yield session
    session.stop()


@pytest.fixture
def stranger(served):
    """Sockets of a program of this computer that does not have the arms."""
    sockets = ClientSockets(served.address, None, states=False)
    yield sockets
    sockets.close()


def send(sockets, *messages):
    """Send messages, or their bytes, and wait until the host has read it all: it answers in order."""
    for message in (*messages, wire.Question(77, "hello")):
        deadline = time.monotonic() + 20.0
        while not send_once(sockets, message):
            assert time.monotonic() < deadline
            time.sleep(0.0005)
    while True:
        sockets.wait(1.0)
        while (message := sockets.receive()) is not None:
            if isinstance(message, wire.Answer) and message.number == 77:
                return
        assert time.monotonic() < deadline


def send_once(sockets, message):
    """Send a message, or its bytes, if there is room."""
    try:
        sockets.commands.send(message if isinstance(message, bytes) else wire.encode(message), zmq.NOBLOCK)
    except zmq.Again:
        return False
    return True


def next_target(session):
    """The number that the client's next target will have."""
    block = SharedBlock(None, COMMAND_DTYPE, create=False, descriptor=os.dup(session[ARM].descriptors.commands))
    with contextlib.closing(block):
        return int(block.read()["target_sequence"]) + 1


def target(number=1, age_s=0.0, request=(Request.NONE, 0)):
    """A command record with a target far away that was given `age_s` ago."""
    record = np.zeros((), COMMAND_DTYPE)
    for field in ("q", "dq", "kp", "kd", "own_kp", "own_kd"):
        record[field] = np.nan
    record["q"][:7] = [*FAR, 0.5]
    record["target_stamp_s"], record["target_sequence"] = time.monotonic() - age_s, number
    record["request"], record["request_sequence"] = request
    return record.tobytes()


def stays(session, seconds=0.2):
    """Whether the arm is not asked to go anywhere."""
    before = session[ARM].published().setpoint_q
    time.sleep(seconds)
    state = session[ARM].published()
    return np.abs(state.setpoint_q - before).max() < 0.01 and state.mode in (Mode.HOLD, Mode.TRACK)


def test_commands_of_others_are_dropped(served, session, stranger):
    before = hello(Host(served.address))["groups"]["robot"]["dropped"]
    send(stranger, wire.Command(9, 99, 0, target()))
    send(stranger, *(wire.Command(9, n, 0, target(request=(r, 1))) for n, r in enumerate(Request)))
    assert stays(session)
    assert hello(Host(served.address))["groups"]["robot"]["dropped"] == before + 1 + len(Request)


def test_commands_that_are_repeated_or_old_are_dropped(served, session, stranger):
    """Even with the right session number, which no other client knows."""
    group = served.groups[0]
    number, newest = group.lease.holder, group.newest
    replayed = wire.Command(number, newest, 0, target(next_target(session)))
    first = next_target(session)
    old = wire.Command(number, newest + 1, 0, target(first, age_s=0.6))
    from_the_future = wire.Command(number, newest + 2, 0, target(first + 1, age_s=-0.3))
    no_arm = wire.Command(number, newest + 3, 5, target(first))
    before = group.dropped
    send(stranger, replayed, old, from_the_future, no_arm)
    assert stays(session) and group.dropped == before + 3  # by the host: the control loop would refuse an old one, too
    group.newest = newest


@pytest.mark.parametrize("leader", ["../../../etc/passwd", "rig.leader_left"])
def test_a_follower_follows_leaders_of_the_host_only(served, session, stranger, leader):
    group = served.groups[0]
    newest = group.newest
    record = np.frombuffer(target(next_target(session)), COMMAND_DTYPE, count=1).copy()
    record["leader"] = leader.encode()
    send(stranger, wire.Command(group.lease.holder, newest + 1, 0, record.tobytes()))
    assert stays(session)
    group.newest = newest


def test_a_second_client_is_refused_by_the_name_of_the_first(served, session):
    with pytest.raises(ChannelInUseError, match=r"the host's robot is driven by .*@.* \(process \d+\); end that first"):
        Host(served.address).ask("start", group="robot", session=5, who="somebody", search=True)
    assert Host(served.address).ask("stop", group="robot", session=5)["landed"]
    assert stays(session, 0.1)


def hostile(seed, count):
    """Messages at random: noise, right heads with noise, whole ones with a byte changed, senseless questions."""
    draw = random.Random(seed)
    messages = [
        wire.Command(draw.getrandbits(63), 1 << 60, 0, target()),
        wire.Question(1, "start", group="robot", session=4, who="x"),
        wire.States(1, "", False, [], []),
        wire.Echo(0.0, 0.0, 0.0, False),
    ]
    packed = [wire.encode(message) for message in messages]
    asks = [{"op": op, "group": group} for op in ("start", "stop", "estop", "", 3, None) for group in ("robot", 7, "x")]
    for _ in range(count):
        kind, message = draw.randrange(4), bytearray(draw.choice(packed))
        if kind == 0:
            yield draw.randbytes(draw.randrange(1, 3000))
        elif kind == 1:
            yield wire.HEAD + draw.randbytes(draw.randrange(1500))
        elif kind == 2:
            message[draw.randrange(8, len(message))] ^= draw.randrange(1, 256)
            yield bytes(message)
        else:
            yield wire.encode(wire.Question(draw.getrandbits(40), **draw.choice(asks)))


@pytest.mark.parametrize("count", [400, pytest.param(10_000, marks=pytest.mark.long)])
def test_hostile_messages_have_no_effect(served, session, stranger, count):
    seed = 1 if count < 1000 else int.from_bytes(os.urandom(4))
    send(stranger, *hostile(seed, count))
    assert stays(session), f"seed {seed}"
    track(session, {ARM: POSE}, 0.3)
    assert session[ARM].observe().mode is Mode.TRACK


def test_a_release_that_is_asked_again_does_not_undo_a_stop_that_has_come_since(served, session, stranger):
    stop = EmergencyStop()

    def release():
        return wire.Question(7, "estop", SYSTEM.now(), action="release", sources=["a"])

    try:
        send(stranger, wire.Question(6, "estop", action="latch", who="a", why="test\x1b"), release())
        assert not stop.latched
        stop.latch("another", "a")
        send(stranger, release())
        assert stop.latched
    finally:
        stop.release()
    session[ARM].hold()


def test_what_a_dead_client_has_sent_energises_and_releases_nothing_when_it_comes_late(served, session, stranger):
    """TCP delivers it when the network is back."""
    (group,) = served.groups
    session.stop()
    old_s, stop = SYSTEM.now() - 2.5, EmergencyStop()
    starts = [wire.Question(8, "start", sent_s, "robot", 9, who="dead") for sent_s in (old_s, 0.0, old_s + 1e6)]
    try:
        send(stranger, *starts)
        assert group.phase is Phase.FREE and group.lease.holder != 9
        stop.latch("a test", "dead")
        send(stranger, wire.Question(10, "estop", old_s, who="dead", action="release"))
        assert stop.latched
        send(stranger, wire.Question(11, "estop", old_s, who="late", action="latch"))
        assert stop.names() == ["dead", "late"]
        send(stranger, wire.Question(12, "estop", SYSTEM.now(), who="dead", action="release"))
        assert stop.names() == ["late"]
    finally:
        stop.release()


def test_a_client_of_another_version_hears_that_it_is_one(served, stranger):
    message = bytearray(wire.encode(wire.Question(1, "hello")))
    message[4] ^= 1  # the layout of the records
    deadline = time.monotonic() + 5.0
    while (answer := stranger.receive()) is None:
        assert time.monotonic() < deadline
        send_once(stranger, bytes(message))
        stranger.wait(0.05)
    assert answer == wire.Answer(0)  # whose head names this version


def test_nothing_listens_beyond_this_computer_without_keys():
    with pytest.raises(ConfigError, match="no client is paired.*yam-host pair"):
        HostSockets(HostAddress("0.0.0.0"), None)


@pytest.mark.long
def test_only_paired_clients_are_heard(tmp_path):
    pair(tmp_path / "host", "one", tmp_path / "one.json")
    pair(tmp_path / "other", "two", tmp_path / "two.json")
    stranger = LinkKey.load(tmp_path / "two.json")
    host = LinkKey.load(tmp_path / "one.json").host
    with running_rig(arms=[ARM]) as rig, ServedArms(rig, ARM, keys=tmp_path / "host") as served:
        session = served.session(key=str(tmp_path / "one.json"))
        session.start()
        track(session, {ARM: POSE}, 1.0)
        assert np.abs(session[ARM].observe().q - POSE).max() < 0.1
        for key in (None, LinkKey(stranger.public, stranger.secret, host), stranger):
            sockets = ClientSockets(served.address, key)
            deadline = time.monotonic() + 1.5
            while time.monotonic() < deadline:
                sockets.send(wire.Question(1, "hello"))
                sockets.send(wire.Beat(0, "", 0.0, False))
                sockets.wait(0.05)
                assert sockets.receive() is None and sockets.newest_states() is None
            sockets.close()
        with pytest.raises(LinkError, match="is this computer paired"):
            hello(Host(served.address))
        assert stays(session, 0.1)
        session.stop()
