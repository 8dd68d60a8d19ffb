"""Simulated worlds: furnished apartments, GLB scenes, painted rooms, photographs.

A world is a function from a seed to a `Scene`, or to a `SimulatedScene`, which another simulator holds. `load` finds
one by its name. Packages add their own under the entry-point group ``eagor.worlds`` (a name, and the function, or a
`WorldOf` if it needs to be told more); ``eagor bench run TASK --world NAME`` uses it. Every world has to pass
`eagor.lab.worlds.checking.check_world`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import TYPE_CHECKING, Protocol, runtime_checkable

from eagor import plugins
from eagor.errors import WorldError

if TYPE_CHECKING:
    import numpy as np

    from eagor.lab.worlds.ground import Ground
    from eagor.lab.worlds.render import Frame
    from eagor.lab.worlds.scene import Instance, Room, Scene

__all__ = ["SimulatedScene", "View", "World", "WorldOf", "ground_of", "known", "load", "view_of"]

GROUP = "eagor.worlds"
BUILT_IN = {"apartment": "eagor.lab.worlds.apartment:generate", "habitat": "eagor.lab.worlds.habitat.world:WORLD"}
FILES = (".glb", ".gltf")


class World(Protocol):
    """Makes a scene from a seed."""

    def __call__(self, seed: int, /) -> Scene | SimulatedScene:
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


@runtime_checkable
class SimulatedScene(Protocol):
    """A scene that another simulator holds: no triangles, but its things, its ground and its pictures.

    Frames and names are those of a `Scene`: metres, z up, the floor at z = 0. The instances' indices are the ids in
    pictures. `source`: the simulator and the scene, in words; `hash`: hexadecimal digits that change with the scene, as
    episodes are made for one scene alone.
    """

    @property
    def instances(self) -> tuple[Instance, ...]: ...
    @property
    def rooms(self) -> tuple[Room, ...]: ...
    @property
    def source(self) -> str: ...
    @property
    def hash(self) -> str: ...

    def ground(self, radius: float, /) -> Ground:
        """The ground for a body of this radius, metres. Raises `WorldError` if there is no room for it."""
        ...

    def view(self) -> View:
        """The renderer."""
        ...

    def close(self) -> None:
        """Free what the simulator holds; it opens again when it is needed."""
        ...


def known() -> dict[str, EntryPoint]:
    """The worlds that `load` can make, by name. Imports none of them."""
    return plugins.known(GROUP, BUILT_IN)


@dataclass(frozen=True)
class WorldOf:
    """Worlds that need to be told more than their name: ``name:argument`` is the world `make(argument)`.

    `wanted`: the argument in words ("SCENE, the path of ..."), for the error if it is missing.
    """

    make: Callable[[str], World]
    wanted: str


def load(name: str) -> World:
    """The world ``"apartment"``, an installed one (``name`` or ``name:argument``), or a GLB file.

    Raises `WorldError`, or `EagorError` on import.
    """
    choices = known()
    short, colon, argument = name.partition(":")
    if short in choices:
        found = plugins.bring(choices[short], "world")
        if isinstance(found, WorldOf):
            if not argument:
                raise WorldError(f"the world {short!r} wants {short}:{found.wanted}")
            return found.make(argument)
        if colon:
            raise WorldError(f"the world {short!r} takes no argument, but {argument!r} follows its name; leave it out")
        return found
    if Path(name).suffix.lower() in FILES:
        from eagor.lab.worlds.glb import import_glb

        return lambda seed: import_glb(Path(name))
    raise WorldError(f"there is no world {name!r}; known are {', '.join(sorted(choices))}, and GLB files (*.glb)")


def ground_of(scene: Scene | SimulatedScene, radius: float) -> Ground:
    """The ground of what a world made, for a body of this radius. Raises `WorldError` if there is no room to stand."""
    from eagor.lab.worlds.ground import Ground
    from eagor.lab.worlds.scene import Scene

    return Ground.from_scene(scene, radius=radius) if isinstance(scene, Scene) else scene.ground(radius)


def view_of(scene: Scene | SimulatedScene) -> View:
    """The renderer of what a world made."""
    from eagor.lab.worlds.render import Renderer
    from eagor.lab.worlds.scene import Scene

    return Renderer(scene) if isinstance(scene, Scene) else scene.view()
