"""The ground and the renderer of what a world made: a scene of ours, or one that another simulator holds."""

from __future__ import annotations

from eagor.worlds import SimulatedScene, View
from eagor.worlds.scene import Scene
from eagor.worlds.walkable import Walkable

__all__ = ["ground_of", "view_of"]


def ground_of(scene: Scene | SimulatedScene, radius: float) -> Walkable:
    """The ground of what a world made, for a body of this radius. Raises `WorldError` if there is no room to stand."""
    from eagor.worlds.ground import Ground

    return Ground.from_scene(scene, radius=radius) if isinstance(scene, Scene) else scene.ground(radius)


def view_of(scene: Scene | SimulatedScene) -> View:
    """The renderer of what a world made."""
    from eagor.worlds.render import Renderer

    return Renderer(scene) if isinstance(scene, Scene) else scene.view()
