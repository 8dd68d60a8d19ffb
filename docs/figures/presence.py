"""Draw presence, the probability that the thing is here at all, after hits and after misses of a real tracker.

python docs/figures/presence.py [FOLDER]

One look a second, a camera that stands, and the default model of a detector, which knows nothing of it: the habit of a
place and the number of false alarms are learnt. A hit is a detection of score 0.6; a miss is a whole look without one.
"""

from __future__ import annotations

import numpy as np
from common import OURS, QUIET, TARGET, THEIRS, figure, keep, lines, titled

from eagor import DirectionTracker, Evidence, TrackerConfig, direction

LOOKS, SCORE = 30, 0.6
PLACE = direction(0.6, -0.2)
STORIES = {  # which looks find it
    "found in every look": (TARGET, lambda look: True),
    "found in every third look": (OURS, lambda look: look % 3 == 0),
    "found in the first five looks": (THEIRS, lambda look: look < 5),
    "found in the first look only": ("#e69f00", lambda look: look < 1),
    "never found": (QUIET, lambda look: False),
}
SHOWN = (1, 2, 5, 10, 20, 30)


def presences(finds) -> np.ndarray:
    """Presence ``(LOOKS,)`` after each look."""
    tracker, found = DirectionTracker(TrackerConfig()), []
    for look in range(LOOKS):
        tracker.add_pose(float(look), np.eye(3))
        hits = [PLACE] if finds(look) else []
        tracker.observe(Evidence.from_points(hits, scores=[SCORE] * len(hits), stamp=float(look)))
        found.append(tracker.estimate(float(look)).presence)
    return np.array(found)


def table() -> list[str]:
    """What the figure shows, as numbers."""
    rows = [f"{'presence after looks':30}" + "".join(f"{number:6}" for number in SHOWN)]
    for name, (_, finds) in STORIES.items():
        found = presences(finds)
        rows.append(f"{name:30}" + "".join(f"{found[number - 1]:6.2f}" for number in SHOWN))
    return rows


def main() -> None:
    """Draw it, and print the table."""
    sheet = figure(1100, 380)
    axes = sheet.add_axes((0.05, 0.14, 0.62, 0.7))
    for name, (colour, finds) in STORIES.items():
        axes.plot(np.arange(1, LOOKS + 1), presences(finds), color=colour, lw=2.2, label=name)
        hits = [look + 1 for look in range(LOOKS) if finds(look)]
        axes.plot(hits, presences(finds)[np.array(hits, int) - 1], "o", color=colour, ms=4.5, ls="none")
    axes.axhline(0.5, color="#1f2430", lw=0.8, ls=(0, (2, 3)))
    axes.set_xlim(0.5, LOOKS + 0.5)
    axes.set_ylim(0, 1.02)
    axes.set_xlabel("looks, one a second; dots are hits")
    lines(axes)
    titled(axes, "Presence after hits and misses", "the probability that the thing is here at all; it begins at a half")
    axes.legend(frameon=False, fontsize=10, loc="center left", bbox_to_anchor=(1.02, 0.5))
    keep(sheet, "method-presence.png")
    print("\n".join(table()))


if __name__ == "__main__":
    main()
