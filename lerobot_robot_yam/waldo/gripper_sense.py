"""The two senses of a gripper's position. Here and nowhere else one becomes the other."""


def swapped(position: float) -> float:
    """Commander's position (0 open … 1 closed) as ours (0 closed … 1 open), or ours as Commander's."""
    return 1.0 - position
