"""A perception, a world and a task of one's own, in one file: copy it, keep what you need, change the rest.

Install it beside eagor (``pip install ./examples/plugin``), and every command knows what ``pyproject.toml`` names:

    eagor locate PANO "brightest" --perception brightness
    eagor bench run turntable --world hall --perception truth --episodes 5

Each of the three has a check that ships with eagor; call it from your tests:

    check_perception(Brightness(), panorama, "brightest", roll=16)    # eagor.perception
    check_world(hall)                                                 # eagor.lab.worlds.checking
    check_simulation(TURNTABLE, world="hall")                         # eagor.lab.tasks.sim.rollout, once installed
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import trimesh

from eagor import ErpGrid, Evidence
from eagor.errors import QueryError, WorldError
from eagor.lab.envs.episodes import Episode, EpisodeSpec, choose_target
from eagor.lab.envs.place_env import AnsweringEnv
from eagor.lab.envs.places import load_place, pixels_of
from eagor.lab.tasks.sim.rollout import Rollout
from eagor.lab.tasks.sim.task import SimTask
from eagor.lab.tasks.task import degrees
from eagor.lab.worlds.scene import Instance, Lamp, Material, Room, Scene
from eagor.sphere import world_R_body

# --- a perception: a panorama and a query in, evidence out -----------------------------------------------------------


class Brightness:
    """Finds what is bright, or dark. The scale is fixed: a frame's own maximum would turn nothing into something."""

    def __call__(self, panorama: np.ndarray, query: str, *, stamp: float | None = None) -> Evidence:
        """Evidence for the query "brightest" or "darkest"; raises `QueryError` for other words."""
        if query not in ("brightest", "darkest"):
            raise QueryError(f"the query is {query!r}; brightness knows 'brightest' and 'darkest'")
        light = panorama.mean(axis=-1) / 255
        response = np.clip(((light if query == "brightest" else 1 - light) - 0.8) / 0.15, 0.0, 1.0)
        return Evidence.from_response(response, ErpGrid(*light.shape), stamp=stamp)


# --- a world: a scene from a seed ------------------------------------------------------------------------------------

PAINTS = {"red": (0.7, 0.1, 0.1), "blue": (0.1, 0.2, 0.7), "green": (0.1, 0.5, 0.2), None: (0.8, 0.78, 0.74)}
HEIGHT = 2.6


def hall(seed: int) -> Scene:
    """An empty hall with three cabinets of three colours along its walls; metres, z up, the floor at z = 0."""
    rng = np.random.default_rng(seed)  # everything that is random comes from the seed
    width, depth = (float(value) for value in rng.uniform(6.0, 9.0, 2))
    boxes: list[tuple[str, str | None, tuple, tuple]] = [
        ("floor", None, (0, 0, -0.1), (width, depth, 0)),
        ("ceiling", None, (0, 0, HEIGHT), (width, depth, HEIGHT + 0.1)),
        ("wall", None, (-0.1, 0, 0), (0, depth, HEIGHT)),
        ("wall", None, (width, 0, 0), (width + 0.1, depth, HEIGHT)),
        ("wall", None, (0, -0.1, 0), (width, 0, HEIGHT)),
        ("wall", None, (0, depth, 0), (width, depth + 0.1, HEIGHT)),
    ]
    for colour, corner in zip(("red", "blue", "green"), rng.permutation(3), strict=True):
        x, y = [(0.3, 0.3), (width - 1.1, 0.3), (0.3, depth - 0.8)][corner]
        boxes.append(("cabinet", colour, (x, y, 0), (x + 0.8, y + 0.5, float(rng.uniform(0.8, 1.6)))))
    meshes = [trimesh.creation.box(bounds=[low, high]) for _, _, low, high in boxes]
    first = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    owner = np.repeat(np.arange(len(boxes)), [len(mesh.faces) for mesh in meshes]).astype(np.int32)
    looks = list(PAINTS)
    return Scene(
        vertices=np.concatenate([mesh.vertices for mesh in meshes]).astype(np.float32),
        triangles=np.concatenate([m.faces + start for m, start in zip(meshes, first, strict=False)]).astype(np.int32),
        instance=owner,
        material=np.array([looks.index(boxes[index][1]) for index in owner], dtype=np.int32),
        uv=np.zeros((len(owner), 3, 2), dtype=np.float32),
        instances=tuple(
            Instance(category, colour, "hall", np.array(low, dtype=float), np.array(high, dtype=float))
            for category, colour, low, high in boxes
        ),
        materials=tuple(Material(str(name), paint) for name, paint in PAINTS.items()),
        rooms=(Room("hall", "hall", np.array([[0.0, 0.0, width, depth]])),),
        lamps=(Lamp(np.array([width / 2, depth / 2, 2.3]), np.full(3, 1.5)),),
        source=f"hall 1.0 seed {seed}",  # the name of the world, its version, the seed
    )


# --- a task: an environment, what is measured, the columns of its table ----------------------------------------------


@dataclass(frozen=True)
class TurntableRules:
    """`steps`: of one full turn. `visible_pixels`: so many pixels of a 64 x 128 panorama make a target visible."""

    steps: int = 24
    visible_pixels: int = 6


class TurntableEnv(AnsweringEnv):
    """The camera turns once around itself, and names the direction of a thing at each step."""

    task = "turntable"
    rules = TurntableRules()

    def plan(self, spec: EpisodeSpec) -> Episode:
        """The episode of this spec. Everything random comes from ``spec.rng``."""
        place = load_place(spec.world, spec.seed, self.camera.radius)
        rng = spec.rng("plan")
        for target, query in choose_target(place, rng):
            for _ in range(20):
                x, y = (float(value) for value in place.ground.sample(rng))
                ids = place.ids(np.array([x, y, self.camera.height]), world_R_body(0.0))
                if pixels_of(ids, (target,)) >= self.rules.visible_pixels:
                    start = float(rng.uniform(-math.pi, math.pi))
                    turns = start + 2 * math.pi * np.arange(self.rules.steps) / self.rules.steps
                    return Episode(
                        spec=spec,
                        scene=place.scene.source,
                        scene_hash=place.scene.hash,
                        query=query,
                        targets=(target,),
                        start=(x, y),
                        yaw=start,
                        shortest=float(place.way_to((target,)).distance(np.array([x, y]))),
                        stratum={"colour": place.scene.instances[target].colour or "none"},
                        route=tuple((x, y, math.remainder(float(turn), 2 * math.pi)) for turn in turns),
                    )
        raise WorldError(f"{place.scene.source} has nothing that is in view from anywhere")


def measure(result: Rollout) -> dict[str, float | None]:
    """Figures of one method in one episode: mean error and the error at the end, degrees."""
    errors = [error for error in result.trace["error_deg"] if error is not None]
    return {"error": float(np.mean(errors)), "last": errors[-1]}


TURNTABLE = SimTask(
    name="turntable",
    title="Turntable",
    what="name the direction of a thing while the camera turns once around itself",
    environment=TurntableEnv,
    rules=TurntableRules,
    measure=measure,
    metrics=(
        degrees("error", "Error", "mean direction error"),
        degrees("last", "Last", "error after the whole turn"),
    ),
    headline="error",
    strata={"colour": "Colour of the target"},
)
