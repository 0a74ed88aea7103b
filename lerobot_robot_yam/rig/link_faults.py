"""What can be made to fail between a motor and its driver, for tests."""

from collections.abc import Mapping
from dataclasses import dataclass

from lerobot_robot_yam.errors import ConfigError


@dataclass
class LinkFaults:
    """Everything off by default."""

    silent: bool = False  # neither obeys nor answers, as if unpowered
    drop_next: int = 0  # so many answers are lost
    loss_rate: float = 0.0  # share of answers lost
    delay_s: float = 0.0  # answers come so much late
    duplicate: bool = False  # a second motor has the same identifiers and answers too
    sticky_fault: int | None = None  # fault nibble that CLEAR cannot clear
    temperatures_c: tuple[float, float] | None = None  # (power stage, coil) reported instead

    def any(self) -> bool:
        """Whether something is set that concerns the answers on the wire."""
        return bool(self.drop_next or self.loss_rate or self.delay_s or self.duplicate)

    def set(self, changes: Mapping[str, object]) -> None:
        """Change some.

        Raises:
            ConfigError: no such kind of fault.
        """
        for name, value in changes.items():
            if name not in self.__dataclass_fields__:
                raise ConfigError(f"no fault kind {name!r}; known: {', '.join(self.__dataclass_fields__)}")
            setattr(self, name, value)
