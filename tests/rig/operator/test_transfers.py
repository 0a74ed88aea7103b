"""The count of transfers, on made-up histories of a prop."""

import numpy as np
import pytest

from tests.support.transfers import Transfers

PLACES = {"A": (0.3, 0.28), "M": (0.33, 0.0), "B": (0.3, -0.28)}
A, M, B = ((*PLACES[name], 0.02) for name in "AMB")


def judged(
    *points, lie_s: float = 0.5, move_s: float = 1.0, transfers: Transfers | None = None, held: bool = False
) -> list[dict]:
    """Events of a prop that lies at the first point, moves in straight lines through the others, and lies again."""
    transfers = transfers or Transfers("cube", PLACES)
    track = [points[0]] * int(lie_s * 100)
    for start, end in zip(points, points[1:], strict=False):
        track += list(np.linspace(start, end, int(move_s * 100)))
    track += [points[-1]] * int(lie_s * 100)
    times = [i / 100 for i in range(len(track))]
    updates = [transfers.update(at, 1000 + at, point, lambda: held) for at, point in zip(times, track, strict=True)]
    return [event for events in updates for event in events]


def over(start, end, lift_m: float):
    return start, (*start[:2], 0.02 + lift_m), (*end[:2], 0.02 + lift_m), end


def test_lift_carry_and_rest_is_a_transfer():
    (event,) = judged(*over(A, M, 0.08))
    assert event["kind"] == "transfer" and event["prop"] == "cube"
    assert event["lift_m"] == pytest.approx(0.08, abs=1e-3)
    assert event["carry_m"] == pytest.approx(np.hypot(0.03, 0.28), abs=1e-3)
    assert event["from"]["place"] == "A" and event["to"]["place"] == "M"
    assert event["start"]["sim_s"] < event["end"]["sim_s"]
    assert event["end"]["monotonic_s"] == pytest.approx(1000 + event["end"]["sim_s"])


@pytest.mark.parametrize(
    "points",
    [over(A, M, 0.04), over(A, (0.3, 0.15, 0.02), 0.08)],
    ids=["too low", "too near"],
)
def test_less_than_that_is_a_drop(points):
    assert [event["kind"] for event in judged(*points)] == ["drop"]


def test_pushing_along_the_table_gives_no_event():
    assert judged(A, M) == []


def test_pushing_does_not_count_as_carrying():
    pushed = (0.3, 0.05, 0.02)
    assert [event["kind"] for event in judged(A, *over(pushed, M, 0.08))] == ["drop"]


def test_in_the_air_nothing_is_decided():
    high = (*M[:2], 0.1)
    assert judged(A, (*A[:2], 0.1), high, lie_s=2.0) == []


def test_a_held_prop_has_not_come_to_rest():
    low = (*M[:2], 0.025)  # 5 mm above the table
    transfers = Transfers("cube", PLACES)
    for at in np.arange(-1.0, 0.0, 0.01):
        transfers.update(at, 1000 + at, A, lambda: False)
    assert judged(*over(A, low, 0.08), lie_s=0.5, transfers=transfers, held=True) == []
    (event,) = [event for i in range(40) for event in transfers.update(10 + i / 100, 1010.0, M, lambda: False)]
    assert event["kind"] == "transfer"


def test_two_transfers_between_the_ends_are_a_cycle():
    events = judged(*over(A, M, 0.08), *over(M, B, 0.07))
    assert [event["kind"] for event in events] == ["transfer", "transfer", "cycle"]
    cycle = events[-1]
    assert cycle["from"]["place"] == "A" and cycle["to"]["place"] == "B"
    assert cycle["lift_m"] == pytest.approx(0.07, abs=1e-3)
    assert cycle["start"] == events[0]["start"] and cycle["end"] == events[1]["end"]


def test_there_and_back_to_the_middle_is_no_cycle():
    events = judged(*over(A, M, 0.08), *over(M, A, 0.08))
    assert [event["kind"] for event in events] == ["transfer", "transfer"]


def test_a_drop_on_the_way_spoils_the_cycle():
    near = (0.3, 0.1, 0.02)
    events = judged(*over(A, M, 0.08), *over(M, near, 0.02), *over(near, B, 0.08))
    assert [event["kind"] for event in events] == ["transfer", "drop", "transfer"]


def test_a_fall_is_told_once():
    events = judged(A, (0.3, 0.28, 0.1), (0.3, 0.9, 0.1), (0.3, 0.9, -0.7))
    assert [event["kind"] for event in events] == ["fall"]


def test_placing_it_by_hand_is_no_transfer():
    transfers = Transfers("cube", PLACES)
    judged(A, A, transfers=transfers)
    transfers.reset()
    assert judged(B, B, transfers=transfers) == []
