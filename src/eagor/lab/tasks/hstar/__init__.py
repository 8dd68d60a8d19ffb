"""H*Bench: look around in a panorama through a perspective camera, and name the direction of the target.

It has two halves, object search (HOS) and path search (HPS). `rules` (with prompts and the camera) are the
benchmark's own, quirks included; `data` reads its files; `agents` has all who play, and our search; `bench` is for
`eagor bench`.
"""

from eagor.lab.tasks.hstar.data import Episode, read_episodes
from eagor.lab.tasks.hstar.rules import (
    Action,
    Reply,
    View,
    Window,
    parse_action,
    render_view,
    submit_succeeds,
    window_of,
)

__all__ = [
    "Action", "Episode", "Reply", "View", "Window", "parse_action", "read_episodes", "render_view", "submit_succeeds",
    "window_of",
]  # fmt: skip
