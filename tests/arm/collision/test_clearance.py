"""Distances between parts of the arms: geometric truths, which parts are compared, and that no conflict is missed."""

import numpy as np
import pytest

from lerobot_robot_yam.arm.collision.clearance import Clearance
from lerobot_robot_yam.arm.collision.parts import GuardedArm
from lerobot_robot_yam.arm.collision.workspace import KeepOut, WorkspaceConfig
from lerobot_robot_yam.arm.mounting import resolve_profiles
from lerobot_robot_yam.arm.profile_files import ARMS, GRIPPERS
from lerobot_robot_yam.errors import ConfigError

HOME = np.array([0.0, 1.2, 1.2, -0.5, 0.0, 0.0])
MARGIN = 0.02
COMBINATIONS = [(arm, gripper) for arm in ARMS for gripper in GRIPPERS]


def guarded(name="left", arm="yam", gripper="linear_4310", **workspace):
    return GuardedArm(name, *resolve_profiles(arm, gripper), WorkspaceConfig(**workspace))


def pair_of_arms(gap_m=0.5, **workspace):
    return [
        guarded(name, base_position_m=[0.0, y, 0.0], **workspace)
        for name, y in (("left", gap_m / 2), ("right", -gap_m / 2))
    ]


def all_distances(clearance, q):
    clearance.parts.place(np.asarray(q))
    return np.array([clearance.distance(pair) for pair in clearance.pairs])


def random_poses(arms, count, seed=0):
    low, high = np.concatenate([arm.arm.joint_limits_rad for arm in arms]).T
    return np.random.default_rng(seed).uniform(low, high, size=(count, len(low)))


@pytest.mark.parametrize(("arm", "gripper"), COMBINATIONS)
def test_every_arm_rests_without_a_conflict_and_may_fold_and_unfold(arm, gripper):
    one = guarded(arm=arm, gripper=gripper, collision_margin_m=MARGIN, floor_z_m=-0.005)
    clearance = Clearance([one])
    rest = one.arm.rest_q(one.gripper)
    assert all(d >= pair.limit_m for pair, d in zip(clearance.pairs, all_distances(clearance, rest), strict=True))
    way = [rest + share * (np.array([0.3, 1.2, 1.2, rest[3], 0.5, 0.5]) - rest) for share in np.linspace(0, 1, 40)]
    for start, end in (*zip(way, way[1:], strict=False), *zip(way[::-1], way[-2::-1], strict=False)):
        assert not clearance.conflicts(start, end)


@pytest.mark.parametrize("arm", ARMS)
def test_only_links_that_cannot_part_are_left_out(arm):
    clearance = Clearance([guarded(arm=arm, collision_margin_m=MARGIN)])
    link = clearance.parts.link
    compared = {(link[pair.first], link[pair.second]) for pair in clearance.pairs}
    every = {(a, b) for a in range(7) for b in range(a + 2, 7)}
    assert every - compared == {(0, 2), (3, 5), (4, 6)}  # next but one in the chain, housing beside housing
    limits = {(link[pair.first], link[pair.second]): pair.limit_m for pair in clearance.pairs}
    assert limits[2, 6] == limits[0, 4] == MARGIN
    # The wrist may lean on the shoulder motor, but not on the rest of the upper arm.
    upper_arm = [pair.limit_m for pair in clearance.pairs if (link[pair.first], link[pair.second]) == (2, 5)]
    assert min(upper_arm) < 0.0 and max(upper_arm) == MARGIN


def test_a_hull_contains_its_shapes_and_not_much_more():
    parts = Clearance(
        [guarded(collision_margin_m=MARGIN, keep_out=[KeepOut(name="far", center_m=[2, 2, 2], size_m=[1, 1, 1])])]
    ).parts
    (far,) = parts.things_of(0)
    for q in random_poses([guarded()], 20):
        parts.place(q)
        for body in set(parts.body) - {parts.body[far]}:
            of_link = [part for part in range(parts.count) if parts.body[part] == body]
            (hull,) = [parts.distance(part, far) for part in of_link if parts.is_hull[part]]
            nearest = min(parts.distance(part, far) for part in of_link if not parts.is_hull[part])
            assert nearest - 0.012 < hull < nearest + 1e-6


def test_distances_do_not_depend_on_where_the_rig_frame_is():
    arms = pair_of_arms(
        collision_margin_m=MARGIN,
        floor_z_m=0.0,
        keep_out=[KeepOut(name="mast", center_m=[0.4, 0.0, 0.3], size_m=[0.05, 0.1, 0.6])],
    )
    yaw, shift = 0.7, np.array([0.3, -0.2, 0.5])
    turn = np.array([[np.cos(yaw), -np.sin(yaw), 0], [np.sin(yaw), np.cos(yaw), 0], [0, 0, 1]])
    moved = [
        guarded(
            arm.name,
            base_position_m=(turn @ arm.workspace.base_position_m + shift).tolist(),
            base_yaw_rad=yaw,
            collision_margin_m=MARGIN,
            floor_z_m=shift[2],
            keep_out=[
                KeepOut(
                    name="mast",
                    center_m=(turn @ [0.4, 0.0, 0.3] + shift).tolist(),
                    size_m=[0.05, 0.1, 0.6],
                    yaw_rad=yaw,
                )
            ],
        )
        for arm in arms
    ]
    here, there = Clearance(arms), Clearance(moved)
    for q in random_poses(arms, 10):
        before, after = all_distances(here, q), all_distances(there, q)
        apart = before > 0
        np.testing.assert_allclose(before[apart], after[apart], atol=1e-6)
        np.testing.assert_allclose(before[~apart], after[~apart], atol=1e-3)


def test_a_floor_and_a_box_are_where_they_were_put():
    for height in (0.0, 0.05, -0.2):
        clearance = Clearance([guarded(floor_z_m=height)])
        lowest = all_distances(clearance, HOME).min()
        assert lowest + height == pytest.approx(
            all_distances(Clearance([guarded(floor_z_m=-0.5)]), HOME).min() - 0.5, abs=1e-6
        )
    # Turning the base changes no height, but for the 1e-6 rad by which the vendor's axis is off the vertical.
    box = KeepOut(name="shelf", center_m=[0.0, 0.0, 0.9], size_m=[2.0, 2.0, 0.2])
    clearance = Clearance([guarded(keep_out=[box])])
    heights = [all_distances(clearance, [turn, *HOME[1:]]) for turn in (-1.0, 0.0, 2.0)]
    np.testing.assert_allclose(heights[0], heights[1], atol=1e-5)
    np.testing.assert_allclose(heights[0], heights[2], atol=1e-5)


def test_a_closed_gripper_is_narrower():
    box = KeepOut(name="wall", center_m=[0.3, 0.4, 0.3], size_m=[1.0, 0.1, 1.0])
    clearance = Clearance([guarded(keep_out=[box])])
    opened = all_distances(clearance, HOME).min()
    assert clearance.parts.open_grippers([0.0])
    assert not clearance.parts.open_grippers([0.0])
    assert all_distances(clearance, HOME).min() > opened + 0.01
    assert clearance.parts.open_grippers([1.0])
    assert all_distances(clearance, HOME).min() == pytest.approx(opened)


def test_every_conflict_is_found_and_no_other():
    arms = pair_of_arms(
        gap_m=0.4,
        collision_margin_m=MARGIN,
        floor_z_m=-0.02,
        keep_out=[KeepOut(name="mast", center_m=[0.35, 0, 0.4], size_m=[0.06, 0.06, 0.8])],
    )
    clearance = Clearance(arms)
    limits = np.array([pair.limit_m for pair in clearance.pairs])
    rng = np.random.default_rng(1)
    seen = 0
    for start in random_poses(arms, 60, seed=1):
        end = start + rng.normal(size=12) * rng.choice([0.001, 0.01, 0.04])
        found = {(c.pair.first, c.pair.second): c for c in clearance.conflicts(start, end, 0.3)}
        way = np.array([all_distances(clearance, start + share * (end - start)) for share in np.linspace(0, 1, 21)])
        floor = np.minimum(limits, way[0])
        for pair, least, last, enough in zip(clearance.pairs, way.min(axis=0), way[-1], floor, strict=True):
            conflict = found.get((pair.first, pair.second))
            if last < enough - 1e-4 or least < enough - 2e-3:
                assert conflict is not None, (pair, least, enough)
                seen += 1
            if conflict is not None:
                assert conflict.there_m < enough and conflict.there_m > least - 1e-3
    assert seen > 50


def test_a_thin_thing_between_start_and_end_is_seen():
    post = KeepOut(name="post", center_m=[0.35, 0.0, 0.4], size_m=[0.01, 0.01, 0.8])
    clearance = Clearance([guarded(keep_out=[post])])
    for turn in (0.4, 0.6, 0.9):
        for bias in (0.0, 0.07, -0.07):
            start, end = (HOME + [bias + side * turn, 0, 0, 0, 0, 0] for side in (1, -1))
            assert min(all_distances(clearance, start).min(), all_distances(clearance, end).min()) > 0
            assert clearance.conflicts(start, end, most_steps=1000)


def test_arms_that_stand_in_one_another_or_share_a_name_are_refused():
    with pytest.raises(ConfigError, match="left base and right base stand in one another.*base_position_m"):
        Clearance([guarded("left", collision_margin_m=MARGIN), guarded("right", collision_margin_m=MARGIN)])
    with pytest.raises(ConfigError, match="different names"):
        Clearance([guarded("left"), guarded("left")])


def test_a_gripper_without_an_arm_is_in_the_way_of_an_arm():
    alone = guarded("alone", arm="none", base_position_m=[0.3, 0.0, 0.2])
    clearance = Clearance([alone, guarded("left", collision_margin_m=MARGIN)])
    assert clearance.parts.joints == [0, 6]
    assert any(
        c.pair.arms == (1,)
        for c in clearance.conflicts(np.array([1.2, 1.6, 1.0, -0.5, 0, 0]), np.array([0.0, 1.6, 1.0, -0.5, 0, 0]))
    )
