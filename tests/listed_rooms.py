"""A small room and episodes in it, for tests of what is exported."""

import gzip
import json
from functools import partial

from box_scenes import scene_of, shell, thing

from eagor.lab.worlds.glb import export_glb, import_glb
from eagor.lab.worlds.objectnav import export_dataset


def room(source="room"):
    """Five by four metres with two chairs and a bed."""
    things = [
        *shell(5.0, 4.0),
        thing("chair", (1.0, 2.9, 0), (1.4, 3.3, 0.9), colour="red"),
        thing("chair", (4.2, 0.4, 0), (4.6, 0.8, 0.9), colour="blue"),
        thing("bed", (3.2, 2.4, 0), (4.9, 3.8, 0.5)),
    ]
    return scene_of(things, source=source)


def exported(folder, episodes=4, names=("room",)):
    """A data folder with such rooms as GLB scenes; returns the path of its episodes."""
    scenes = {}
    for number, name in enumerate(names):
        path = export_glb(room(name), folder / "made" / f"{name}.glb")
        scenes[f"{number:05d}-{name}"] = partial(import_glb, path)
    file, _ = export_dataset(scenes, folder / "data", episodes=episodes, categories=("chair",))
    return file


def contents(file):
    """The parsed content files beside ``<split>.json.gz``, in the order of their names."""
    return [json.loads(gzip.decompress(each.read_bytes())) for each in sorted((file.parent / "content").iterdir())]
