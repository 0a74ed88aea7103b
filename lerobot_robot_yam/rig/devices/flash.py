"""What a simulated motor keeps when its power goes, and what its firmware does when it is told to store.

No public source says what happens in either bad case, so we chose it:
- "reverts": STORE keeps the register that was written last; the others in RAM become what flash held.
- "cut": the power goes in the middle. Half of the changed registers are in flash, and the motor is silent.
"""

from collections.abc import Mapping

WAYS = ("all", "reverts", "cut")


class Flash:
    """Flash of one motor.

    Attributes:
        way: how it stores, one of `WAYS`.
        writes: how often it has stored.

    Args:
        registers: what it holds at first, by number.
    """

    def __init__(self, registers: Mapping[int, float | int]):
        self.held = dict(registers)
        self.way, self.writes = "all", 0

    def store(self, ram: Mapping[int, float | int], last: int | None) -> dict[int, float | int]:
        """Store the registers; `last` was written last. Returns what RAM holds afterwards."""
        self.writes += 1
        changed = [number for number, value in ram.items() if value != self.held[number]]
        if self.way == "cut":
            changed = changed[: (len(changed) + 1) // 2]
        elif self.way == "reverts":
            changed = [number for number in changed if number == last]
        self.held |= {number: ram[number] for number in changed}
        return dict(self.held) if self.way == "reverts" else dict(ram)
