"""What else is here: all that a detector with known classes has seen, each thing followed by itself.

One pass of such a detector answers for every class: those that it saw, and those that it did not. A thing begins when
it is seen first, with all looks before, at which it was not: the tracker keeps one target for whatever was never seen,
and a new thing begins as its copy. So nothing is lost, and no look has to be kept.

The cost is bounded by leaving out whole looks, whatever they show. A look is taken in thing by thing as there is time
for it (`Surroundings.take_in`), and one that comes before the last is taken in is left out.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from eagor.evidence import BodyMask, Evidence
from eagor.tracking.config import TrackerConfig
from eagor.tracking.estimate import Estimate
from eagor.tracking.tracker import DirectionTracker
from eagor.tracking.tracks import SAME_MOMENT

__all__ = ["NEAR", "Around", "Surroundings", "ThingSeen"]

NEAR = math.radians(15)  # the error that still leads a person to the thing
MOST = 40  # things, of 5 MB each
NEVER_SEEN = ""  # the target for all classes that were never seen


@dataclass(frozen=True, eq=False)
class Around:
    """One look for all classes: the evidence for each class that was `found`, and `nothing`, that for every other."""

    found: Mapping[str, Evidence]
    nothing: Evidence

    def at(self, stamp: float) -> Around:
        """The same look, captured at another time."""
        found = {name: replace(each, stamp=stamp) for name, each in self.found.items()}
        return Around(found, replace(self.nothing, stamp=stamp))

    def covered(self, mask: BodyMask) -> Around:
        """The same look without what `mask` hides."""
        return Around({name: each.covered(mask) for name, each in self.found.items()}, self.nothing.covered(mask))


@dataclass(frozen=True, eq=False)
class ThingSeen:
    """What is known of one thing: `looks`, in how many looks it was seen, of `among`; `last`, the stamp of the last.

    `query`: its class, or the words that were looked for.
    """

    query: str
    estimate: Estimate
    looks: int
    among: int
    last: float

    @property
    def sure(self) -> float:
        """The probability that it is here, and within 15 degrees of the answer."""
        return self.estimate.within(NEAR) if self.estimate.direction is not None else 0.0


@dataclass
class _Count:
    looks: int = 0
    last: float = -math.inf


class Surroundings:
    """Follows every class that was seen, `most` at a time: beyond, what was not seen for longest is forgotten.

    Poses come with `move`, looks with `look`; `take_in` does the work, a few milliseconds a call. `among`: how many
    looks counted, `newest`: the stamp of the last. Settings are those of a tracker. Not for several threads.
    """

    def __init__(self, config: TrackerConfig | None = None, most: int = MOST) -> None:
        self.tracker, self.most = DirectionTracker(config), most
        self.reset()

    def reset(self) -> None:
        """Forget everything, the poses too."""
        self.tracker.reset()
        self.among, self.newest = 0, -math.inf
        self._seen: dict[str, _Count] = {}
        self._behind: deque[str] = deque()  # those that the newest look is still to be taken in for

    @property
    def names(self) -> tuple[str, ...]:
        """What was seen, in the order in which it was seen first."""
        return tuple(self._seen)

    @property
    def behind(self) -> bool:
        """Whether the newest look is still to be taken in for some of them."""
        return bool(self._behind)

    def move(self, stamp: float, world_R_body: np.ndarray, position: np.ndarray | None = None) -> None:
        """A pose of the camera, as for `eagor.tracking.follower.Follower.move`."""
        self.tracker.add_pose(stamp, world_R_body, None if self.tracker.config.ranges is None else position)

    def look(self, around: Around) -> bool:
        """Take in a look soon; returns whether it counts, or comes too early, or out of order.

        It has a stamp, as all of its evidence. Further views of the same moment count with the first. Raises as
        `DirectionTracker.observe`.
        """
        stamp = around.nothing.stamp
        assert stamp is not None
        new = stamp > self.newest + SAME_MOMENT
        if (new and self._behind) or stamp < self.newest - SAME_MOMENT:
            return False
        for name in around.found:
            if name not in self._seen and NEVER_SEEN in self.tracker.targets:
                self.tracker.begin(name, NEVER_SEEN)
        for name in (*dict.fromkeys((*self._seen, *around.found)), NEVER_SEEN):
            self.tracker.observe(around.found.get(name, around.nothing), name)
        self.among, self.newest = self.among + new, max(self.newest, stamp)
        for name in around.found:
            count = self._seen.setdefault(name, _Count())
            count.looks, count.last = count.looks + (count.last < self.newest), self.newest
        while len(self._seen) > self.most:
            oldest = min(self._seen, key=lambda each: self._seen[each].last)
            del self._seen[oldest]
            self.tracker.forget(oldest)
        self._behind = deque(self.tracker.targets)
        return True

    def take_in(self) -> None:
        """Take in the newest look for one more of the things, if there is one for which that is still to be done."""
        if self._behind:
            self.tracker.settle(self._behind.popleft())

    def thing(self, name: str, now: float) -> ThingSeen:
        """What is known of one of `names` at the time `now`. Raises as `DirectionTracker.estimate`."""
        count = self._seen[name]
        estimate = self.tracker.estimate(max(now, self.newest), name)
        return ThingSeen(name, estimate, count.looks, self.among, count.last)

    def things(self, now: float) -> list[ThingSeen]:
        """All that was seen, the surest first."""
        return sorted((self.thing(name, now) for name in self._seen), key=lambda each: -each.sure)
