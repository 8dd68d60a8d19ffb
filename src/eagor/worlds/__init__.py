"""Simulated worlds: furnished apartments, GLB scenes, painted rooms, photographs.

A world is a function from a seed to a `Scene`. `load` finds one by its name. Packages add their own under the
entry-point group ``eagor.worlds`` (a name, and the function); ``eagor bench run TASK --world NAME`` uses it. Every
world has to pass `eagor.worlds.checking.check_world`.
"""

from __future__ import annotations

from importlib.metadata import EntryPoint
from pathlib import Path
from typing import TYPE_CHECKING, Protocol, runtime_checkable

from eagor import plugins
from eagor.errors import WorldError

if TYPE_CHECKING:
    import numpy as np

    from eagor.worlds.render import Frame
    from eagor.worlds.scene import Scene

__all__ = ["View", "World", "known", "load"]

GROUP = "eagor.worlds"
BUILT_IN = {"apartment": "eagor.worlds.apartment:generate"}
FILES = (".glb", ".gltf")


class World(Protocol):
    """Makes a scene from a seed."""

    def __call__(self, seed: int, /) -> Scene:
        """The scene of this seed: always the same one for the same version of the world.

        Metres, z up, the floor at z = 0. Its `source` names the world, its version and the seed. Instances have
        categories in lower-case words and colours from `eagor.queries.COLOURS`, since tasks ask for them by these.
        Raises `WorldError` for a seed without a scene.
        """
        ...


@runtime_checkable
class View(Protocol):
    """Anything that renders panoramas: the renderer of a scene, one photograph, another simulator."""

    def panorama(
        self, position: np.ndarray | tuple[float, float, float], world_R_body: np.ndarray, height: int, /, *,
        rgb: bool = True, range: bool = True, ids: bool = True,
    ) -> Frame:  # fmt: skip
        """The panorama ``(height, 2 height)`` from `position` ``(3,)``, metres, in the pose `world_R_body`.

        In the layout of `eagor.sphere`; when the camera turns left, everything moves right. A part is None if it is
        not requested or not available. Raises `PoseError` for an impossible position.
        """
        ...


def known() -> dict[str, EntryPoint]:
    """The worlds that `load` can make, by name. Imports none of them."""
    return plugins.known(GROUP, BUILT_IN)


def load(name: str) -> World:
    """The world ``"apartment"``, an installed one, or a GLB file. Raises `WorldError`, or `EagorError` on import."""
    choices = known()
    if name in choices:
        return plugins.bring(choices[name], "world")
    if Path(name).suffix.lower() in FILES:
        from eagor.worlds.glb import import_glb

        return lambda seed: import_glb(Path(name))
    raise WorldError(f"there is no world {name!r}; known are {', '.join(sorted(choices))}, and GLB files (*.glb)")
