"""OSR-Bench: questions about one panorama, answered and scored by the benchmark's own rules.

`score` and `direction_label` are its scorer and its label generator. The published left and right are mirrored: see
`eagor.tasks.osr.layout`.
"""

from eagor.tasks.osr.layout import direction_label, distance_label, swapped
from eagor.tasks.osr.scoring import lenient, score, score_map

__all__ = ["direction_label", "distance_label", "lenient", "score", "score_map", "swapped"]
