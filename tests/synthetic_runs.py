"""Made-up runs, seeded: records as the tasks write them, with cases that are missing and units that failed."""

import json

import numpy as np

from eagor.conventions import wxyz_from_rotation
from eagor.sphere import azimuth_elevation, world_R_body

SKILL = {
    "centroid": 60,
    "cent_circ": 45,
    "grid": 40,
    "eagor_paper": 32,
    "vmf": 22,
}  # typical error, degrees; others: 11
METHODS = (*SKILL, "grid_filter", "particle_filter", "eagor")
WITHOUT = ("centroid", "cent_circ", "grid", "eagor_paper")  # a distribution
TARGET = np.array([6.0, 4.5, 0.6])


class Walk:
    """A body that walks by `stride` along headings, and what it sees of a target in each step."""

    def __init__(self, yaws, stride, target):
        moves = stride * np.stack([np.cos(yaws), np.sin(yaws), 0 * yaws], axis=-1)
        places, turns = np.array([2.0, 3.0, 1.2]) + np.cumsum(moves, axis=0), [world_R_body(yaw) for yaw in yaws]
        self.pose = [[*place, *wxyz_from_rotation(turn)] for place, turn in zip(places, turns, strict=True)]
        offsets = np.array([turn.T @ (target - place) for place, turn in zip(places, turns, strict=True)])
        self.azimuth, self.elevation = (np.degrees(each) for each in azimuth_elevation(offsets))
        self.range_m = np.linalg.norm(offsets, axis=-1).tolist()
        self.seam = np.abs(np.diff(self.azimuth, prepend=self.azimuth[0])) > 180

    def truth(self, visible, **more):
        return {"pose": self.pose, "azimuth_deg": self.azimuth.tolist(), "elevation_deg": self.elevation.tolist(),
                "range_m": self.range_m, "visible": visible.tolist(), "seam": self.seam.tolist(), **more}  # fmt: skip

    def answer(self, rng, name):
        """The errors of a method in its steps, whether its regions hold the target (None: it has none), its trace."""
        steps = len(self.azimuth)
        error = np.minimum(
            SKILL.get(name, 11) * (0.5 + 0.8 * rng.random(steps)) * (1 + np.exp(-np.arange(steps) / 6)), 175
        )
        inside = None if name in WITHOUT else error < 20
        trace = {
            "azimuth_deg": ((self.azimuth + rng.choice([-1, 1], steps) * error + 180) % 360 - 180).tolist(),
            "elevation_deg": self.elevation.tolist(),
            "error_deg": error.tolist(),
            "inside": [None] * steps if inside is None else inside.tolist(),
        }
        return error, None if inside is None else float(inside.mean()), trace


def record(task, name, apartment, number, stratum=(), **more):
    episode = {
        "id": f"{apartment}-{number}", "seed": apartment, "scene": f"apartment 1 seed {apartment}",
        "scene_hash": f"{apartment:016x}", "query": "red chair", "targets": [1], "stratum": dict(stratum),
    }  # fmt: skip
    return {"key": f"{task}/{name}", "task": task, "attempt": 1, "status": "ok", "seconds": 2.0, "episode": episode,
            **more}  # fmt: skip


def mean(error, where):
    return float(error[where].mean()) if where.any() else None


def waypoint(seed=0, apartments=8, each=3, methods=METHODS, steps=32):
    rng, found = np.random.default_rng(seed), []
    legs = np.repeat([1, 2, 3, 4], steps // 4)
    turns = np.where(np.diff(legs, prepend=1) > 0, legs * np.radians(35), 0.02)
    for apartment, number in ((2000 + a, k) for a in range(apartments) for k in range(each)):
        walk, visible = Walk(np.cumsum(turns), 0.12, TARGET + rng.normal(size=3)), rng.random(steps) > 0.3
        answers = {}
        for name in methods:
            error, coverage, trace = walk.answer(rng, name)
            metrics = {f"L{leg}": mean(error, legs == leg) for leg in (1, 2, 3, 4)}
            metrics |= {"delta": metrics["L4"] - metrics["L1"], "occ": mean(error, ~visible), "tc": 3.0}
            metrics |= {"seam": mean(error, walk.seam), "tc_rotation": 4.0, "coverage": coverage}
            answers[name] = {"metrics": metrics, "trace": trace}
        truth = walk.truth(visible, leg=[f"L{leg}" for leg in legs])
        found.append(record("waypoint", f"{apartment}-{number}", apartment, number, methods=answers, truth=truth))
    return found


def tracking(seed=0, apartments=6, methods=METHODS, steps=40):
    rng, found = np.random.default_rng(seed), []
    scenarios = enumerate(("moving target", "moving camera", "target gone"))
    for apartment, (number, scenario) in ((2000 + a, each) for each in scenarios for a in range(apartments)):
        walk, there = Walk(np.arange(steps) * 0.1, 0.12, TARGET + rng.normal(size=3)), np.ones(steps, dtype=bool)
        there[12:22] = scenario != "target gone"
        answers = {}
        for name in methods:
            error, coverage, trace = walk.answer(rng, name)
            metrics = {"error": float(error.mean()), "tc": 3.0, "time_lost": 100 * float((error > 30).mean())}
            metrics |= {"recovery": 2.0 if scenario != "moving camera" else None, "coverage": coverage}
            answers[name] = {"metrics": metrics, "trace": trace}
        made = record("tracking", f"{apartment}-{number}", apartment, number, {"scenario": scenario})
        found.append(made | {"methods": answers, "truth": walk.truth(there, present=there.tolist())})
    return found


def navigation(seed=0, apartments=8, each=3, methods=METHODS):
    """Each method goes its own way, so each has a record of its own; two could not be run."""
    rng, found = np.random.default_rng(seed), []
    for apartment, number in ((2000 + a, k) for a in range(apartments) for k in range(each)):
        stratum = {"visible": bool(rng.random() < 0.5), "way": str(rng.choice(["direct", "winding"]))}
        for name in methods:
            arrived = bool(rng.random() > SKILL.get(name, 11) / 80)
            steps = int(rng.integers(12, 40)) if arrived else 80
            walk = Walk(np.cumsum(rng.normal(size=steps) * 0.25), 0.2, TARGET)
            error, coverage, trace = walk.answer(rng, name)
            spl = float(rng.uniform(0.5, 0.95)) * arrived
            metrics = {
                "success": int(arrived), "spl": spl, "soft_spl": max(spl, 0.3), "steps": steps, "undone": 0.2,
                "mae": float(error.mean()), "seam_crossings": int(walk.seam.sum()), "collisions": 2,
                "starts_at_seam": float(number % 3 == 0), "path_m": 0.2 * steps, "shortest_m": 0.15 * steps,
                "distance_to_goal": 0.4 if arrived else 4.0, "coverage": coverage,
            }  # fmt: skip
            trace |= {"pose": walk.pose, "true_azimuth_deg": walk.azimuth.tolist(), "true_range_m": walk.range_m,
                      "visible": (rng.random(steps) < 0.6).tolist()}  # fmt: skip
            made = record("navigation", f"{apartment}-{number}/{name}", apartment, number, stratum)
            found.append(made | {"methods": {name: {"metrics": metrics, "trace": trace}}})
    for failed in found[5:7]:
        del failed["episode"], failed["methods"]
        failed |= {"status": "failed", "attempt": 2, "error": "WorldError: no way <to> the target & back"}
    return found


def write_run(folder, records, **config):
    folder.mkdir(parents=True, exist_ok=True)
    settings = {
        "task": records[0]["task"],
        "seed": 2000,
        "episodes": len({r["key"].split("/")[1] for r in records}),
        "development": False,
        "perception": "oracle",
        "rules": {"step": 0.25, "success_distance": 1.0},
        "disturbances": {"miss": 0.3, "false_alarm": 0.2},
        "methods": list(dict.fromkeys(m for r in records for m in r.get("methods", {}))),
        "versions": {"eagor": "0.2.0", "apartment": "1"},
        **config,
    }
    (folder / "run.json").write_text(json.dumps(settings))
    (folder / "records.jsonl").write_text("".join(json.dumps(each, allow_nan=False) + "\n" for each in records))
    return folder
