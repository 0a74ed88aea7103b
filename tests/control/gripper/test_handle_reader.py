"""A handle's reports: debounced buttons, the trigger's own range, and silence."""

import math

import pytest

from lerobot_robot_yam.control.gripper.handle_reader import HandleReader
from lerobot_robot_yam.control.gripper.trigger_range import TriggerRange, learn, load_range, save_range
from lerobot_robot_yam.damiao.handle_encoder import TRIGGER_TRAVEL_RAD, HandleEncoder, encode_report
from lerobot_robot_yam.errors import GripperError
from tests.support.rigged import arm_on, lockstep_rig

rig = lockstep_rig("leader_left")
TICK_S = 0.004


def reader(travel=TriggerRange()):  # noqa: B008
    encoder = HandleEncoder()
    return encoder, HandleReader("arm", encoder, travel)


def fed(encoder, found, levels, begin=1.0):
    """What a reader says of the first button, for levels told one per tick."""
    said = []
    for number, down in enumerate(levels):
        now = begin + number * TICK_S
        encoder.accept(encode_report(0.0, 0.0, (down, False)), now)
        said.append(found.read(now).buttons[0])
    return said


UP = [False] * 4  # for as long as a release takes


def test_a_press_counts_at_once_and_lasts_until_the_button_was_up_for_some_time():
    encoder, found = reader()
    said = fed(encoder, found, [*UP, True, False, False, False, False, True])
    assert said == [*UP, True, True, True, True, False, True]
    assert found.read(1.0).presses == (2, 0)


def test_every_tap_of_10_ms_counts_at_any_phase(rig):
    with arm_on(rig, "leader_left") as arm:
        client = arm._session["leader_left"]
        arm.clock.sleep(0.05)
        for number in range(50):
            arm.clock.sleep(0.0213)  # the phase of each tap is another one
            rig.press("leader_left", "record", 0.01)
            arm.clock.sleep(0.05)
            assert client.published().presses == (0, number + 1)


def test_a_button_held_from_the_start_or_through_silence_is_no_press():
    encoder, found = reader()
    assert not any(fed(encoder, found, [True] * 20))
    assert any(fed(encoder, found, [*UP, *[True] * 20], 2.0))
    assert found.read(3.0).buttons == (False, False)
    assert not any(fed(encoder, found, [True] * 20, 3.0))
    assert not any(fed(encoder, found, [False, *[True] * 20], 4.0))
    assert any(fed(encoder, found, [*UP, *[True] * 20], 5.0))
    assert found.read(5.1).presses == (2, 0)


def test_bounce_is_one_press_and_one_release():
    encoder, found = reader()
    levels = [*UP, True, False, True, True, False, *[True] * 10, False, True, False, *[False] * 10]
    said = fed(encoder, found, levels)
    edges = sum(a is not b for a, b in zip(said, said[1:], strict=False))
    assert edges == 2 and said[-1] is False and any(said)


def test_one_report_that_repeats_does_not_count_as_several():
    encoder, found = reader()
    fed(encoder, found, [*UP, True])
    assert [found.read(1.02 + tick * TICK_S).presses for tick in range(20)] == [(1, 0)] * 20
    encoder.accept(encode_report(0.0, 0.0, (False, False)), 1.1)
    assert all(found.read(1.1 + tick * TICK_S).buttons[0] for tick in range(20))


def test_a_stop_does_not_wait_for_the_bounce():
    encoder, found = reader()
    fed(encoder, found, [False, True])
    assert found.raw_buttons == (True, False)


def test_silence_is_told_once_and_never_reads_as_zero(caplog):
    encoder, found = reader()
    fed(encoder, found, [True] * 10)
    for now in (1.5, 1.6, 1.7):
        state = found.read(now)
        assert math.isnan(state.trigger) and state.buttons == (False, False)
    assert caplog.text.count("is silent") == 1


def test_the_range_of_a_trigger_is_used_and_kept(tmp_path):
    path = tmp_path / "handle.json"
    assert load_range("arm", path, "handle") == TriggerRange(0.0, 1.0)
    travel = learn("arm", [0.05, math.nan, 0.4, 0.85, 0.05])
    save_range("arm", path, "handle", travel)
    assert load_range("arm", path, "handle") == travel
    encoder, found = reader(travel)
    for travelled, low, high in [(0.05, 0.0, 0.0), (0.45, 0.45, 0.55), (0.85, 1.0, 1.0)]:
        encoder.accept(encode_report(travelled * TRIGGER_TRAVEL_RAD, 0.0, (False, False)), 1.0)
        assert low <= found.read(1.0).trigger <= high


@pytest.mark.parametrize("text", ["{", "[]", '{"released": 0.9, "squeezed": 0.1, "gripper": "handle", "version": 1}'])
def test_a_damaged_file_is_refused(tmp_path, text):
    path = tmp_path / "handle.json"
    path.write_text(text)
    with pytest.raises(GripperError, match="no range of a trigger"):
        load_range("arm", path, "handle")


def test_a_trigger_that_nobody_squeezed_teaches_nothing():
    with pytest.raises(GripperError, match="moved by 10 % of its travel"):
        learn("arm", [0.0, 0.1])


def test_an_arm_learns_its_trigger_once(rig, tmp_path, monkeypatch):
    path = tmp_path / "handle.json"
    rig.trigger("leader_left", 0.05)
    with arm_on(rig, "leader_left", calibration_path=str(path), gripper_search=False) as arm:
        client = arm._session["leader_left"]
        squeezes = iter([0.05] * 100 + [0.8] * 100)
        sleep = arm.clock.sleep

        def squeeze(seconds):
            rig.trigger("leader_left", next(squeezes, 0.05))
            sleep(seconds)

        monkeypatch.setattr(arm.clock, "sleep", squeeze)
        client.calibrate_trigger()
    with arm_on(rig, "leader_left", calibration_path=str(path)) as arm:
        rig.trigger("leader_left", 0.8)
        arm.clock.sleep(0.1)
        assert arm.observe().trigger == pytest.approx(1.0, abs=0.01)
        rig.trigger("leader_left", 0.05)
        arm.clock.sleep(0.1)
        assert arm.observe().trigger == pytest.approx(0.0, abs=0.01)
