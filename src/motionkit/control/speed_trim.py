"""The speed a steered body goes at, made the wanted one: it is asked for a little more, or less, than is wanted.

A network goes at another speed than its trajectory asks for, by a tenth if it is well trained, by a fourth after two
hours of training, and held feet keep the root back. On a path the place asked for runs ahead of a body that
lags, which makes up for it. A held key has no place: what is lacking is summed up here while the wish stays the same.
Nor does a body change its speed at once: as the wish changes it is asked for more of the change than is wanted.
"""

from __future__ import annotations

import math

from motionkit.control.gait_limits import GaitLimits
from motionkit.control.steering import STANDS_BELOW, Pair

TRIM_SECONDS = 1.0  # in which a lack of speed would be asked for once more
WAIT_SECONDS = 0.5  # after a change of wish, in which the body is still on its way to it
SAME_WISH = 0.1  # of the speed; what differs less is the same wish
LEAD, LEAD_SECONDS = (
    0.3,
    0.35,
)  # share of a change of speed that is asked for beyond it at first, and for how long
LIMITS = (0.75, 1.35)  # of the wanted speed


class SpeedTrim:
    """How much of the wanted speed one character is asked for, found for each of its gaits as it goes.

    The share is kept while another gait goes, and over a change of speed: a body that goes at 0.9 of a speed goes at
    about 0.9 of another one.
    """

    def __init__(self, limits: GaitLimits) -> None:
        self.model, self.limits = limits.model, limits
        self.shares: dict[str, float] = {}
        self._kind = ""
        self._wish: Pair = (0.0, 0.0)
        self._lead = 0.0  # cm/s to ask for beyond the wish, as it has just changed
        self._since = 0  # frames for which the wish is the same

    def __call__(self, kind: str, velocity: Pair, gone: Pair) -> Pair:
        """Return the velocity to ask a gait for in this frame; others are asked for what is wanted.

        Args:
            kind: the type that goes.
            velocity: wanted, x and z in cm/s.
            gone: at which the body goes, x and z in cm/s.
        """
        speed = math.hypot(*velocity)
        if speed < STANDS_BELOW or not self.model.types[kind].goes:
            self._kind = ""
            return velocity
        if kind != self._kind or math.dist(velocity, self._wish) > SAME_WISH * speed:
            change = speed - math.hypot(*self._wish) if kind == self._kind else 0.0
            self._lead = LEAD * min(max(change, -speed), speed)
            self._kind, self._wish, self._since = kind, velocity, 0
        self._since += 1
        share = self.shares.get(kind, 1.0)
        found = self._since > WAIT_SECONDS * self.model.fps
        if found:
            along = (gone[0] * velocity[0] + gone[1] * velocity[1]) / speed
            share += (1.0 - along / speed) / (TRIM_SECONDS * self.model.fps)
            share = min(max(share, LIMITS[0]), LIMITS[1])
        lead = self._lead if self._since <= LEAD_SECONDS * self.model.fps else 0.0
        share = self._within(kind, speed, share * speed + lead) / speed
        if found:
            self.shares[kind] = share
        return share * velocity[0], share * velocity[1]

    def _within(self, kind: str, wanted: float, asked: float) -> float:
        """The speed to ask for: not beyond those of the recordings for the sake of one within them."""
        slowest, fastest = self.limits.speeds(kind)
        return max(min(asked, max(fastest, wanted)), min(slowest, wanted))
