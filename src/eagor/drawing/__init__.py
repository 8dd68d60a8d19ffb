"""Pictures: a belief over a panorama, a track as a video or a page, curves of error over time.

Every function `draw_...` returns a `PIL.Image.Image`. Panoramas and their axes are in the layout of `eagor.sphere`
(centre forward, azimuth grows to the LEFT). matplotlib is imported for the first picture, with the Agg canvas and
without pyplot: it changes no global state and opens no window.
"""

from eagor.drawing.marks import Mosaic
from eagor.drawing.page import BeliefPage
from eagor.drawing.step import StepPainter
from eagor.drawing.still import draw_belief, draw_errors, draw_strip, paint_belief
from eagor.drawing.video import BeliefVideo

__all__ = [
    "BeliefPage", "BeliefVideo", "Mosaic", "StepPainter", "draw_belief", "draw_errors", "draw_strip", "paint_belief",
]  # fmt: skip
