"""OSR-Bench: questions about one panorama, scored by the benchmark's own rules.

`score` and `direction_label` are its scorer and its label generator. Left and right are mirrored in the published
labels: see `eagor.lab.tasks.osr.scoring`.
"""

from eagor.lab.tasks.osr.scoring import direction_label, distance_label, score, score_map, swapped

__all__ = ["direction_label", "distance_label", "score", "score_map", "swapped"]
