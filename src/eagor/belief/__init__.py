"""What all looks say together: a log-posterior on the sphere.

- `Belief` (`direction`): over directions, in spherical harmonics. Turning rotates it exactly, looks add.
- `RangedBelief` (`ranged`): over direction and distance, one such field for each shell of range. It may add that
  things stand on floors.
- Both are read in the same way (`posterior`): it samples one field finely enough for its sharpest peak.

A tracker needs more resolution about the peaks than a belief of limited degree has. It keeps fine `windows` there, and
lays them as patches over a coarse `field` of the whole sphere; `density` finds the candidates and masses of that. All
readings share `basins`; `bank` keeps the habits of places.
"""

from eagor.belief.direction import Belief
from eagor.belief.posterior import CredibleRegion
from eagor.belief.ranged import RangedBelief, log_ranges, mean_range, range_spread

__all__ = ["Belief", "CredibleRegion", "RangedBelief", "log_ranges", "mean_range", "range_spread"]
