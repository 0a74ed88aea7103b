"""Base class of uncopyable objects: LeRobot would delete its copy of a session, and thereby land the arms."""

from typing import NoReturn, SupportsIndex

from lerobot_robot_yam.errors import LifeCycleError


class Uncopied:
    """Object that cannot be copied with `copy.copy` or `copy.deepcopy`, nor pickled."""

    def __reduce_ex__(self, protocol: SupportsIndex) -> NoReturn:
        raise LifeCycleError(
            f"a {type(self).__name__} stands for arms and can be neither copied nor pickled: its copy would drive, and "
            "land, the same arms; hand on the object itself, or its config, from which another can be made"
        )
