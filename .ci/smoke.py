"""One use of what dependencies do for the package: a look, a world as GLB, a report, a model on a server, a cluster."""

import sys
import tempfile
from importlib.metadata import version
from pathlib import Path

import gymnasium
import numpy as np
from contract_server import ContractServer, reddish
from PIL import Image

import eagor
from eagor.cli import main
from eagor.lab.eval import runner
from eagor.lab.tasks.task import Sample
from eagor.lab.worlds import apartment
from eagor.lab.worlds.glb import export_glb, import_glb
from eagor.lab.worlds.render import Renderer
from eagor.perception import load


def double(config):
    """The work of a run: twice the number."""
    return lambda payload: {"value": config["factor"] * payload["number"]}


def smoke(folder: Path) -> None:
    """Raise whatever does not work."""
    scene = apartment.generate(0)
    assert len(import_glb(export_glb(scene, folder / "home.glb")).instances) == len(scene.instances)
    low, high = scene.rooms[0].rectangles[0][:2], scene.rooms[0].rectangles[0][2:]
    frame = Renderer(scene).panorama(np.array([*(low + high) / 2, 1.25]), np.eye(3), 128)
    Image.fromarray(frame.rgb).save(folder / "pano.png")
    picture = str(folder / "chart.png")
    assert main(["locate", str(folder / "pano.png"), "chair", "--perception", "scout", "--picture", picture]) == 0
    environment = gymnasium.make("Eagor/WaypointFollowing-v0")
    environment.reset(seed=0)
    assert main(["doctor"]) == 0
    run = ["bench", "run", "waypoint", "--episodes", "1", "--methods", "eagor", "vmf", "--rows", "32"]
    assert main([*run, "--perception", "truth", "--out", str(folder / "waypoint")]) == 0
    assert main(["bench", "report", str(folder / "waypoint")]) == 0
    with ContractServer(reddish) as server:
        look = load(f"endpoint:qwen@{server.url}?pixels=6272&seam=false")
        tracker = eagor.DirectionTracker(eagor.TrackerConfig())
        tracker.add_pose(0.0, np.eye(3))
        tracker.observe(look(np.full((56, 112, 3), 128, np.uint8), "red chair", stamp=0.0))
    samples = [Sample(str(number), "0", {"number": number}) for number in range(3)]
    done = runner.run(samples, "smoke:double", {"task": "smoke", "factor": 2}, folder / "run", 1, engine="ray")
    assert (done.done, done.failed) == (3, 0), done


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as place:
        smoke(Path(place))
    names = ("numpy", "scipy", "trimesh", "gymnasium", "onnxruntime", "openai", "ray")
    print("works with " + ", ".join(f"{name} {version(name)}" for name in names), file=sys.stderr)
