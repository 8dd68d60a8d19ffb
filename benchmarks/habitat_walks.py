"""Our episodes inside habitat-lab: can they be won there, and do we judge each walk as habitat-lab does?

    python benchmarks/habitat_walks.py --out FOLDER [--parts apartments storeys] [--blind] [--seeds 0 1 ...] [--each 10]

Needs habitat-lab and Habitat-Sim. An oracle walks every episode inside habitat-lab with its configuration
``benchmark/nav/objectnav/objectnav_hm3d.yaml``, of which only the path of the episodes is set (and the CPU, where there
is no NVIDIA card): mesh, steps, distances and measures are habitat-lab's own. Then we judge each walk in ``--world
habitat``: once the places that it went through, once its actions (`habitat_lab.judged`).

- apartments: ten episodes in each of ten development apartments, as ``eagor export habitat`` writes them.
- storeys: buildings of two apartments one above the other, in the layout of HM3D v0.1 and of v0.2, with episodes on
  each storey that bear no mark of ours; as in HM3D, starts and view points are put onto habitat-lab's mesh.

`--blind`: habitat-lab draws no colours and small pictures of depth, and we draw nothing, which takes most of the time
on the CPU and changes no measure. Prints a table; exit code 1 if a success differs, an SPL differs by more than 0.005,
or a start or view point lies more than 1 cm off habitat-lab's mesh. Of the replayed actions those count that touch no
edge of the mesh: at an edge our bodies stop 1 mm earlier than Habitat's, on purpose. FOLDER keeps the walks: the same
command goes on where it was stopped.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest.mock import patch

import common
import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
import habitat_lab

from eagor.conventions import from_gltf, to_gltf
from eagor.worlds.apartment import generate
from eagor.worlds.glb import export_glb
from eagor.worlds.ground import Ground
from eagor.worlds.habitat.semantics import Things
from eagor.worlds.habitat.simulator import Source as SimSource
from eagor.worlds.habitat.simulator import configured
from eagor.worlds.habitat.world import parse, settings_for
from eagor.worlds.habitat_dataset import Source, config_of, export_dataset, make_episodes, make_goals
from eagor.worlds.habitat_files import LAB_BODY, ON_MESH
from eagor.worlds.objectnav import Episode, Goal, SceneEpisodes, write_episodes
from eagor.worlds.render import Frame
from eagor.worlds.scene import Scene

PARTS = ("apartments", "storeys")
RADIUS = 0.18  # metres: of the body
MOST = 0.005  # by which an SPL may differ
OFF = 0.01  # metres that a start or view point of ours may lie off the mesh
# By version: folder of the scenes, of the episodes, number of the building, seeds of its apartments, metres upstairs.
# The second upper floor is no whole number of habitat-lab's voxels above the lower one.
VERSIONS = {
    "v0.1": ("hm3d", "v1", 800, (10, 11), 3.0),
    "v0.2": ("hm3d_v0.2", "v2", 801, (12, 13), 3.05),
}


def apartments(folder: Path, seeds: list[int], each: int) -> Path:
    """The folder of exported apartments; returns its file of episodes."""
    file = folder / "apartments" / "data" / "datasets/objectnav/eagor/v1/val/val.json.gz"
    if not file.is_file():
        sources = [Source(seed, f"apartment{seed:04d}", lambda seed=seed: generate(seed)) for seed in seeds]
        export_dataset(sources, folder / "apartments" / "data", episodes=each, radius=RADIUS)
    return file


# --- buildings of two storeys ---


def stacked(scenes: list[Scene], heights: list[float]) -> Scene:
    """Scenes one above the other, each with its floor at its height, metres."""
    vertices, triangles, instances, materials = [], [], [], []
    instance, material = [], []
    for scene, height in zip(scenes, heights, strict=True):
        up = np.array([0.0, 0.0, height])
        triangles.append(scene.triangles + sum(map(len, vertices)))
        instance.append(scene.instance + len(instances))
        material.append(scene.material + len(materials))
        vertices.append(scene.vertices + up.astype(np.float32))
        instances += [replace(thing, room=None, low=thing.low + up, high=thing.high + up) for thing in scene.instances]
        materials += scene.materials
    return Scene(
        np.concatenate(vertices), np.concatenate(triangles), np.concatenate(instance), np.concatenate(material),
        np.concatenate([scene.uv for scene in scenes]), tuple(instances), tuple(materials), source="building",
    )  # fmt: skip


def storeys(folder: Path, version: str, each: int) -> Path:
    """A building with episodes on both storeys, in the layout of this version of HM3D; returns the file of episodes."""
    scenes_name, episodes_name, number, seeds, upstairs = VERSIONS[version]
    home = folder / version / "data"
    file = home / "datasets/objectnav/hm3d" / episodes_name / "val/val.json.gz"
    if file.is_file():
        return file
    scenes, heights = [generate(seed) for seed in seeds], [0.0, upstairs]
    place = f"val/{number:05d}-building/building.basis.glb"
    export_glb(stacked(scenes, heights), home / "scene_datasets" / scenes_name / place, radius=RADIUS, annotated=True)
    glb = home / "scene_datasets" / scenes_name / place
    for kind in ("stage_config", "semantic", "navmesh"):  # HM3D has none of them
        glb.with_suffix(f".{kind}.json").unlink()
    for kind in ("glb", "txt"):  # HM3D's names
        glb.with_suffix(f".semantic.{kind}").rename(glb.with_name(f"building.semantic.{kind}"))
    config = home / "scene_datasets" / scenes_name / "hm3d_annotated_basis.scene_dataset_config.json"
    content = config_of([place])
    content["stages"]["default_attributes"] |= {
        "semantic_asset": "building.semantic.glb", "semantic_descriptor_filename": "building.semantic.txt",
        "nav_asset": "building.basis.navmesh",
    }  # fmt: skip
    config.write_text(json.dumps(content))
    snap = snapping(glb, config)
    episodes: list[Episode] = []
    goals: dict[str, tuple[Goal, ...]] = {}
    named = f"./data/scene_datasets/{scenes_name}/{config.name}"
    before = 0
    for scene, height in zip(scenes, heights, strict=True):
        ground = Ground.from_scene(scene, radius=RADIUS)
        own = make_goals(scene, ground)
        up = np.array([0.0, 0.0, height])
        for episode in make_episodes(scene, ground, own, each, f"{scenes_name}/{place}", named):
            episodes.append(replace(episode, position=snap(episode.position + up), origin=None, nearest=None))
        for category, things in own.items():
            lifted = [
                replace(
                    thing, instance=thing.instance + before, position=thing.position + up,
                    view_positions=np.array([snap(place + up) for place in thing.view_positions]),
                )
                for thing in things
            ]  # fmt: skip
            goals[category] = (*goals.get(category, ()), *lifted)
        before += len(scene.instances)
    return write_episodes(file.parents[1], "val", [SceneEpisodes(tuple(episodes), goals)])


def snapping(glb: Path, config: Path) -> Any:
    """What puts a point ``(3,)`` of our frame onto habitat-lab's mesh of a scene."""
    import habitat_sim  # pyright: ignore[reportMissingImports]

    found = habitat_sim.PathFinder()
    with habitat_sim.Simulator(configured(habitat_sim, SimSource(str(glb), str(config)), -1, kinds=())) as sim:
        wanted = settings_for(habitat_sim, parse(f"{glb}?body={LAB_BODY}"), None, RADIUS)
        assert sim.recompute_navmesh(found, wanted)
    return lambda point: from_gltf(np.array(found.snap_point(to_gltf(point).astype(np.float32)), dtype=np.float64))


@contextmanager
def drawing_nothing(blind: bool) -> Iterator[None]:
    """Open our scenes without a camera: no things, no pictures, and a floor just below the mesh, for `blind` runs."""
    from eagor.worlds.habitat import simulator, world
    from eagor.worlds.habitat.semantics import box_labels

    def empty(self: Any, position: Any, world_R_body: Any, height: int, **_: Any) -> Frame:
        return Frame(None, None, np.full((height, 2 * height), -1, dtype=np.int32))

    opened = simulator._made
    with ExitStack() as stack:
        for place, name, value in (
            (simulator, "device_for", lambda *_: -1),
            (simulator, "_made", lambda source, gpu, *_: opened(source, gpu, 8, ())),
            (simulator.HabitatView, "panorama", empty),
            (world, "true_floor", lambda view, mesh, options: mesh.surface.storey.level - ON_MESH),
            (world, "things_of", lambda *_: Things((), (), box_labels(()), "none")),
        ):
            if blind:
                stack.enter_context(patch.object(place, name, value))
        yield


# --- the table ---


def rows(name: str, file: Path, walks: list[dict[str, Any]]) -> Iterator[dict[str, Any]]:
    for walk, ours in habitat_lab.judged(file, walks):
        yield {"part": name, "walk": walk, **ours}


def said(name: str, found: list[dict[str, Any]]) -> tuple[list[str], bool]:
    """The lines about a part, and whether all of it is as it should be."""
    lab = [row["walk"]["metrics"] for row in found]
    lines = [
        f"{name}: {len(found)} episodes; in habitat-lab {sum(one['success'] for one in lab):.0f} are won, mean SPL "
        f"{np.mean([one['spl'] for one in lab]):.4f}"
    ]
    free = [row for row in found if row["replayed"]["collisions"] == 0]
    fine = True
    for judge, kept in (("measured", found), ("replayed", free)):
        pairs = [(row[judge], row["walk"]["metrics"]) for row in kept]
        equal = sum(ours["success"] == theirs["success"] for ours, theirs in pairs)
        apart = {
            key: max(abs(ours[key] - theirs[key]) for ours, theirs in pairs)
            for key in ("spl", "soft_spl", "distance_to_goal")
        }
        fine &= equal == len(kept) and apart["spl"] <= MOST
        lines.append(
            f"  {judge}: success equal in {equal} of {len(kept)}; largest differences: SPL {apart['spl']:.4f}, "
            f"SoftSPL {apart['soft_spl']:.4f}, distance {apart['distance_to_goal']:.4f} m"
        )
    touched = [row for row in found if row["replayed"]["collisions"] > 0]
    equal = sum(row["replayed"]["success"] == row["walk"]["metrics"]["success"] for row in touched)
    lines.append(f"  replayed, with contact to the edge of the mesh: success equal in {equal} of {len(touched)}")
    start = max(abs(row["shortest_m"] - row["walk"]["start_m"]) for row in found)
    starts, views = np.array([row["walk"]["off_mesh"] for row in found]).max(axis=0)
    fine &= bool(max(starts, views) <= OFF)
    lines.append(
        f"  shortest way: at most {start:.4f} m apart; off habitat-lab's mesh: starts at most {starts:.4f} m, view "
        f"points {views:.4f} m"
    )
    return lines, fine


def main() -> int:
    options = common.parser(__doc__)
    options.add_argument("--out", type=Path, required=True)
    options.add_argument("--parts", nargs="+", choices=PARTS, default=list(PARTS))
    options.add_argument("--seeds", nargs="+", type=int, default=list(range(10)), help="of the apartments")
    options.add_argument("--each", type=int, default=10, help="episodes of each apartment")
    options.add_argument("--blind", action="store_true", help="hardly any pictures in habitat-lab")
    given = options.parse_args()
    if why := habitat_lab.missing():
        sys.exit(why)
    files = {}
    if "apartments" in given.parts:
        files["apartments"] = apartments(given.out, given.seeds, given.each)
    if "storeys" in given.parts:
        files |= {f"storeys, HM3D {version}": storeys(given.out, version, given.each) for version in VERSIONS}
    fine = True
    for name, file in files.items():
        walks = habitat_lab.walked(file, given.out / f"{name.replace(' ', '-').replace(',', '')}.jsonl", given.blind)
        with drawing_nothing(given.blind):
            found = list(rows(name, file, walks))
        lines, good = said(name, found)
        print("\n".join(lines), flush=True)
        fine &= good
    return 0 if fine else 1


if __name__ == "__main__":
    sys.exit(main())
