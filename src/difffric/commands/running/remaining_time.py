"""How long a piece of work will take yet, from how the like went the last time.

The shares that work tells are rough: a fifth of it may take a second or a minute. How the same
command went on data of this size says which, and how fast it goes this time scales it.
"""

from __future__ import annotations

from bisect import bisect_right

from difffric.commands.running.durations import PastRun

_AS_BEFORE = 5.0
"""How long [s] it is believed that this time goes as the last, before its own pace counts more."""
_SOONEST, _FIRST_SHARE = 5.0, 0.1
"""Without a last time, the seconds and the share from which on the pace until then says
anything."""
_GOES_ON = 0.5
"""Without a last time, what remains at least, as a share of the time since the last news."""


class RemainingTime:
    """Hears what share of the work is done, and when; times are seconds from its beginning."""

    def __init__(self, before: PastRun | None = None):
        self.before = before
        self._shares, self._seconds = [0.0], [0.0]

    def tell(self, share: float, now: float) -> None:
        """Tell that a share is done; it never falls."""
        self._shares.append(max(min(share, 1.0), self._shares[-1]))
        self._seconds.append(now)

    def end(self, now: float) -> PastRun:
        """Return how the work went, which ends now."""
        shares, seconds = [*self._shares, 1.0], [*self._seconds, now]
        # Of what was told several times, when it was told first.
        kept = [0, *(i for i in range(1, len(shares)) if shares[i] > shares[i - 1])]
        if shares[kept[-1]] == 1.0:
            kept[-1] = len(shares) - 1
        return PastRun(tuple(shares[i] for i in kept), tuple(seconds[i] for i in kept))

    def estimate(self, now: float) -> float | None:
        """Return the seconds that remain; None: nothing is known of them."""
        share, since = self._shares[-1], self._seconds[self._shares.index(self._shares[-1])]
        if self.before is None:
            if share < _FIRST_SHARE or now < _SOONEST:
                return None
            left = since * (1 - share) / share - (now - since)
            # A part that goes on for long will go on for a while.
            return max(left, _GOES_ON * (now - since))
        reached = _interpolate(share, self.before)
        pace = (since + _AS_BEFORE) / (reached + _AS_BEFORE)
        place = bisect_right(self.before.shares, share)
        end = self.before.seconds[min(place, len(self.before.seconds) - 1)]
        reached += (now - since) / pace
        if reached > end:  # this part takes longer than it did
            pace, reached = max(pace, (now + _AS_BEFORE) / (end + _AS_BEFORE)), end
        return pace * max(self.before.whole - reached, 0.0)


def _interpolate(share: float, course: PastRun) -> float:
    """Return when, in that course, this share was done."""
    i = bisect_right(course.shares, share)
    if i == 0:
        return 0.0
    if i == len(course.shares):
        return course.whole
    (s_0, s_1), (t_0, t_1) = course.shares[i - 1 : i + 1], course.seconds[i - 1 : i + 1]
    return t_0 + (t_1 - t_0) * (share - s_0) / (s_1 - s_0)


def format_duration(seconds: float) -> str:
    """Return a duration as one says it: `8 s`, `3 min 20 s`, `2 h 10 min`."""
    whole = round(seconds)
    if whole < 60:
        return f"{whole} s"
    if whole < 3600:
        minutes, rest = divmod(whole, 60)
        return f"{minutes} min {rest} s" if rest else f"{minutes} min"
    hours, rest = divmod(round(whole / 60), 60)
    return f"{hours} h {rest} min" if rest else f"{hours} h"


def format_remaining(seconds: float) -> str:
    """Return what remains as it is worth saying, no finer than it is known."""
    if seconds < 5:
        return "a few seconds left"
    step = 5 if seconds < 60 else 10 if seconds < 180 else 60
    return f"about {format_duration(step * max(round(seconds / step), 1))} left"
