"""A belief about one direction, in ten lines.

What is learnt: evidence goes in, a direction with an honest region comes out; turning the camera turns the belief,
exactly; what several looks agree on is surer than one. Azimuth is positive to the LEFT.
"""

import math

import eagor
from eagor.sphere import world_R_body

TURN = 30.0  # degrees: the camera turns to the left between the two looks


def box_at(azimuth_deg: float, grid: eagor.ErpGrid) -> list[float]:
    """What a detector would write: a box of 24 x 20 pixels on the horizon, x0, y0, x1, y1."""
    middle = (180 - azimuth_deg) / 360 * grid.width
    return [middle - 12, grid.height / 2 - 10, middle + 12, grid.height / 2 + 10]


def tell(when: str, belief: eagor.Belief, truth_deg: float) -> None:
    """Print where the belief points, how far that is off, and how sure it is."""
    azimuth, _ = eagor.azimuth_elevation(belief.mode())
    error = math.degrees(eagor.angular_distance(belief.mode(), eagor.direction(math.radians(truth_deg), 0.0)))
    print(
        f"{when:26} {math.degrees(azimuth):6.1f} deg left, {error:.1f} deg off; 90 % of the belief within "
        f"{math.degrees(belief.credible_angle()):.0f} deg"
    )


grid = eagor.ErpGrid(256, 512)  # a panorama of 256 x 512 pixels
belief = eagor.Belief.uniform(degree=15)  # nothing is known
look = eagor.Evidence.from_boxes([box_at(90, grid)], grid, scores=[0.8])
belief = belief.update(look)  # every call returns a new belief
tell("after one look:", belief, 90)

new_R_old = world_R_body(math.radians(TURN)).T  # where old directions are found after the turn
belief = belief.predict(new_R_old)
tell("turned left by 30 degrees:", belief, 90 - TURN)

for _ in range(3):
    look = eagor.Evidence.from_boxes([box_at(90 - TURN, grid)], grid, scores=[0.8])
    belief = belief.update(look)
tell("after three more looks:", belief, 90 - TURN)
