"""Small data sets in H*Bench's layout, made up for tests: coloured squares on a grey panorama."""

import json

import numpy as np
from PIL import Image

COLOURS = {"red": (220, 30, 30), "blue": (30, 60, 220), "green": (30, 170, 60), "yellow": (230, 210, 40)}
TARGETS = {
    "hall": {"red": ([40.0, 70.0], [-15.0, 10.0]), "blue": ([200.0, 230.0], [-30.0, -5.0])},
    "shop": {"green": ([345.0, 20.0], [0.0, 25.0]), "yellow": ([120.0, 150.0], [-20.0, 5.0])},
}


def panorama(targets, height=180, width=400):
    """Not 2:1: longitude and latitude have to be mapped apart."""
    image = np.full((height, width, 3), 128, dtype=np.uint8)
    yaw = (np.arange(width) / width * 360 + 180) % 360
    pitch = 90 - np.arange(height) / height * 180
    for colour, (yaws, pitches) in targets.items():
        across = (yaw - yaws[0]) % 360 <= (yaws[1] - yaws[0]) % 360
        image[np.ix_((pitch >= pitches[0]) & (pitch <= pitches[1]), across)] = COLOURS[colour]
    return image


def entries(targets, paths=False):
    found = []
    for colour, (yaws, pitches) in targets.items():
        item = {"task": f"Find the {colour} square", "yaw": yaws}
        if not paths:
            item["pitch"] = pitches
        found.append(item | {"initial yaw": [0, 90, 180, 270], "level": [0, 1, 2, 2]})
    return found


def write(folder, split="hos_bench", targets=None, suffix="png", paths=False, strip=()):
    """Write a split; returns `folder`. `strip`: keys that entries go without."""
    for scene, squares in (targets or TARGETS).items():
        place = folder / split / scene
        place.mkdir(parents=True, exist_ok=True)
        Image.fromarray(panorama(squares)).save(place / f"pano.{suffix}")
        items = [{k: v for k, v in item.items() if k not in strip} for item in entries(squares, paths)]
        (place / "annotation.json").write_text(json.dumps(items), encoding="utf-8")
    return folder


def patient():
    """A model for the command line: turns right twice, then submits where it looks."""

    def reply(messages):
        from eagor.lab.tasks.hstar import succeeded
        from eagor.perception.vlm import ChatReply

        said = messages[-1].text
        turns = sum(message.role == "assistant" for message in messages)
        if turns < 2:
            return ChatReply("<think>on</think><answer>rotate(90,0)</answer>")
        head = succeeded("(")
        yaw, pitch = said[said.index(head) + len(head) :].partition(")")[0].split(",")
        return ChatReply(f"<answer>submit({float(yaw):.0f},{float(pitch):.0f})</answer>")

    return reply


def lost():
    """A model that is not there."""

    def reply(messages):
        raise ConnectionError("nobody answers")

    return reply
