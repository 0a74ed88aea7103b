"""Another computer on the wire that drives motors: what a lock on this machine cannot keep out."""

from dataclasses import dataclass

_MOST_AT_ONCE = 50  # after a pause of the rig; the rest is skipped

PAYLOADS = ("hold", "zero")


@dataclass
class ForeignDriver:
    """Sends frames to one identifier at a rate, from `since_s` of the rig's clock on.

    payload: "hold", an MIT command to stay where the motor is; "zero", eight zero bytes, which a motor reads as a
    command at the negative end of every range. Identifiers that are no motor's always get zeros.
    """

    ident: int
    rate_hz: float
    payload: str
    since_s: float
    sent: int = 0

    def due(self, now_s: float) -> int:
        """How many frames to send now; they count as sent."""
        behind = int((now_s - self.since_s) * self.rate_hz) - self.sent
        self.sent += max(0, behind)
        return min(max(0, behind), _MOST_AT_ONCE)
