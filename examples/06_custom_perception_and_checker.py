"""A perception of your own, and the check that it has to pass.

What is learnt: a perception is anything that takes a panorama, a query and a stamp, and returns `Evidence`.
`check_perception` tries it and says what is wrong; here it finds the commonest mistake. To make yours known to
`eagor locate --perception NAME`, give your package an entry point (examples/plugin).
"""

import math

import numpy as np

import eagor
from eagor.errors import QueryError
from eagor.lab.worlds.painted import EYE, Ball, bearing, painted_room
from eagor.perception import check_perception


class Darkest:
    """Finds what is nearly black. Answers in [0, 1] on the grid of the panorama, on a scale that never changes."""

    def __call__(self, panorama: np.ndarray, query: str, *, stamp: float | None = None) -> eagor.Evidence:
        if "dark" not in query:
            raise QueryError(f"the query is {query!r}; this perception knows only 'dark'")
        light = panorama.max(axis=-1) / 255
        response = np.clip((0.25 - light) / 0.15, 0.0, 1.0)
        return eagor.Evidence.from_response(response, eagor.ErpGrid(*light.shape), stamp=self.stamp_of(stamp))

    def stamp_of(self, stamp: float | None) -> float | None:
        return stamp


class Forgetful(Darkest):
    """The same, but it forgets to pass the time of capture on."""

    def stamp_of(self, stamp: float | None) -> None:
        return None


ball = Ball((1.0, 2.0, 0.6), 0.5, "black")
panorama = painted_room(128, 256, balls=[ball])
try:
    check_perception(Forgetful(), panorama, "something dark", roll=16)
except AssertionError as error:
    print(f"Forgetful fails: {error}")
check_perception(Darkest(), panorama, "something dark", roll=16)
print("Darkest passes")

belief = eagor.Belief.uniform(15).update(Darkest()(panorama, "something dark"))
truth, _ = bearing(ball, EYE, np.eye(3))
print(f"it finds the black ball, {math.degrees(eagor.angular_distance(belief.mode(), truth)):.1f} deg off")
