"""The time for which a message to the user is visible."""

from __future__ import annotations

HOLD_SECONDS, SECONDS_PER_LETTER = 4.0, 0.06
"""A message is fully visible for HOLD_SECONDS, and SECONDS_PER_LETTER longer for each of its letters."""
FADE_SECONDS = 0.8


class NoticeClock:
    """Tells how strongly a message is visible. A new text is fully visible again."""

    def __init__(self) -> None:
        self._text = ""
        self._since = 0.0

    def strength(self, text: str, now: float) -> float:
        """Return the strength of ``text`` at the time ``now`` in seconds: 1 while it is fully visible, 0 at its end."""
        if text != self._text:
            self._text, self._since = text, now
        return min(max(1 - (now - self._since - self._hold) / FADE_SECONDS, 0.0), 1.0) if text else 0.0

    def restart(self, now: float) -> None:
        """Show the message as long as if it were new, for example because the mouse is over it."""
        self._since = now

    def is_fading(self, text: str, now: float) -> bool:
        """Return whether the picture of ``text`` changes at the time ``now``."""
        return bool(text) and (text != self._text or now - self._since > self._hold)

    @property
    def _hold(self) -> float:
        return HOLD_SECONDS + SECONDS_PER_LETTER * len(self._text)
