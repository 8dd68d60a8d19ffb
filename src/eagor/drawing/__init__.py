"""Pictures: a belief over a panorama, curves of error over time, a walk from above.

Every function `draw_...` returns a `PIL.Image.Image`. Panoramas are in the layout of `eagor.sphere` (centre forward,
azimuth grows to the LEFT), and so are the axes. matplotlib is imported when the first picture is drawn, with the Agg
canvas and without pyplot: nothing global is touched, no window is opened.
"""

from eagor.drawing.charts import draw_errors, draw_map
from eagor.drawing.panorama import draw_belief, draw_strip, paint_belief

__all__ = ["draw_belief", "draw_errors", "draw_map", "draw_strip", "paint_belief"]
