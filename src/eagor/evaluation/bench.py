"""A run of one simulated task: its settings, its units of work, and its folder."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any

from eagor import plugins, worlds
from eagor._version import __version__
from eagor.errors import EagorError
from eagor.evaluation.workers import Outcome, Unit, carry_out
from eagor.perception import rows_of
from eagor.perception.calibrated import Calibrated
from eagor.tasks import task as tasks
from eagor.tasks.episodes import Slot, listed_slots, scene_files, slots
from eagor.tasks.methods import NAMES, ORACLE, fitted, make_method
from eagor.tasks.models import shared
from eagor.tasks.places import APARTMENT, DEVELOPMENT
from eagor.tasks.rules import Camera, Disturbances, as_dict, from_dict

WORK = "eagor.tasks.play:work"
PER_RUN = 20  # episodes of a run that names no number and no file


@dataclass(frozen=True)
class Run:
    """What is run. `settings` override single rules, of the task, the camera or the disturbances, by name.

    `rows` of the panoramas; None: what the perception works at. `calibrated`: how our tracker reads and forgets; None:
    as the perception and the tracker have it. `episodes_file`: play what this file lists
    (`eagor.tasks.episodes`), in scenes below the folder `scenes`; then `episodes` None means all of them, and
    `seed` nothing.
    """

    task: str
    perception: str
    episodes: int | None
    seed: int
    methods: tuple[str, ...] = NAMES
    world: str = APARTMENT
    rows: int | None = None
    disturbances: Disturbances = field(default_factory=Disturbances)
    calibrated: Calibrated | None = None
    settings: dict[str, Any] = field(default_factory=dict)
    episodes_file: Path | None = None
    scenes: Path | None = None

    def config(self) -> dict[str, Any]:
        """Everything that decides the results, as the JSON of run.json.

        Raises `EagorError` for what does not exist, and for rules that nothing can be played under.
        """
        import numpy as np

        from eagor.worlds.apartment import VERSION

        task = tasks.load(self.task)
        for name in self.methods:
            if name != ORACLE or not task.walked:
                make_method(name, np.random.default_rng(0))  # complains about unknown ones
        if len(set(self.methods)) != len(self.methods) or not self.methods:
            raise EagorError(f"methods {list(self.methods)}; wanted at least one, each once")
        if self.episodes_file is None and self.world != APARTMENT:
            _read_world(self.world)  # complains about one that cannot be read
        if self.episodes_file is not None and task.listed is None:
            able = ", ".join(name for name in tasks.known() if tasks.load(name).listed is not None)
            raise EagorError(f"{self.task} plays no episodes of a file; {able} does")
        slots = self.slots()  # complains about a file that cannot be played
        if self.episodes_file is not None and self.world != APARTMENT:
            _try_world(slots)
        begin = task.rules() if self.episodes_file is None else task.rules.objectnav()  # type: ignore[attr-defined]
        parts = {"rules": begin, "camera": Camera(), "disturbances": self.disturbances}
        values = {name: as_dict(part) for name, part in parts.items()}
        for key, value in self.settings.items():
            homes = [name for name in values if key in values[name]]
            if not homes:
                known = ", ".join(sorted(key for part in values.values() for key in part))
                raise EagorError(f"there is no rule {key!r}; known are {known}")
            values[homes[0]][key] = _like(values[homes[0]][key], value, key)
        for name, part in parts.items():
            from_dict(type(part), values[name])  # complains about rules that nothing can be played under
        if self.episodes_file is None and values["rules"].get("goal") == "view_points":
            raise EagorError("goal=view_points needs episodes that have view points: --episodes-file")
        return {
            "task": self.task,
            "perception": self.perception,
            "episodes": len(slots),
            "seed": self.seed,
            "development": self.seed in DEVELOPMENT if self.episodes_file is None else _tuned_on(slots),
            **self._listed(),
            "methods": list(self.methods),
            "fitted": {
                name: text for name in self.methods if (text := fitted(self.perception, name.partition(":")[0]))
            },
            "world": self.world,
            "rows": self.rows or rows_of(shared(self.perception)),
            **({"calibrated": self.calibrated.as_json()} if self.calibrated else {}),
            **values,
            "versions": {"eagor": __version__, "apartment": VERSION, **self._plugins()},
        }

    def slots(self) -> list[Slot]:
        """The slots of the episodes. Raises `WorldError`."""
        if self.episodes_file is not None:
            return [*listed_slots(self.task, self.episodes_file, self.episodes, self.world, self.scenes)]
        return list(slots(self.task, PER_RUN if self.episodes is None else self.episodes, self.seed, self.world))

    def _listed(self) -> dict[str, Any]:
        """The settings of episodes from a file."""
        if self.episodes_file is None:
            return {}
        return {"episodes_file": str(self.episodes_file), **({"scenes": str(self.scenes)} if self.scenes else {})}

    def _plugins(self) -> dict[str, str]:
        """The versions of what other packages bring to this run, by kind and name."""
        from eagor import perception

        used = (
            ("perception", perception.known(), self.perception.partition(":")[0]),
            ("world", worlds.known(), self.world.partition(":")[0]),
            ("task", tasks.known(), self.task),
        )
        found = {f"{kind} {name}": plugins.version_of(known[name]) for kind, known, name in used if name in known}
        return {name: version for name, version in found.items() if version is not None}

    def units(self, config: object = None) -> list[Unit]:
        """One unit per episode; where the task is walked, one per episode and method: each goes its own way there."""
        found, walked = [], tasks.load(self.task).walked
        for slot in self.slots():
            name = f"{self.task}/{slot.id}"
            if walked:
                keys = [(f"{name}/{method}", [method]) for method in self.methods]
            else:
                keys = [(name, list(self.methods))]
            for key, methods in keys:
                found.append(Unit(key, str(slot.seed), {"slot": asdict(slot), "methods": methods}))
        return found


def start(run: Run, folder: Path, **how: Any) -> Outcome:
    """Play what `folder` has no record of yet, and record it; `how` as in `eagor.evaluation.workers.carry_out`.

    Raises `EagorError` if the folder holds another run, or for anything that `run` names and does not exist;
    `StorageError` if the disk does not take the results.
    """
    config = run.config()  # makes the perception: one that cannot be made is no failure of an episode
    return carry_out(run.units(), WORK, config, folder, **how)


def _tuned_on(listed: Sequence[Slot]) -> bool:
    """Whether one of these is in an apartment on which parameters were chosen."""
    return any(slot.world == APARTMENT and slot.seed in DEVELOPMENT for slot in listed)


def _try_world(listed: Sequence[Slot]) -> None:
    """Open the first scene that is there: a missing simulator is no failure of every episode. Raises `EagorError`."""
    there = [slot for slot in listed if (files := scene_files([slot])) and files[0].exists()]
    if there:
        _read_world(there[0].world)
    else:
        worlds.load(listed[0].world)  # complains about one that does not exist


@lru_cache(maxsize=1)
def _read_world(world: str) -> None:
    """Read a GLB file or a simulator's scene once, so that one that cannot be read is no failure of every episode.

    Raises `WorldError`, `MissingExtraError`.
    """
    made = worlds.load(world)
    if world not in worlds.known():  # worlds of other packages need not have a scene of seed 0
        scene = made(0)
        if isinstance(scene, worlds.SimulatedScene):
            scene.close()  # the processes that play open their own


def variants(task: str) -> tuple[str, ...]:
    """The ablations of our tracker and of the published one, as methods."""
    if tasks.load(task).walked:
        return (ORACLE,)
    degrees = (3, 5, 7, 11, 15, 21, 31)
    return (
        *(f"eagor:degree={degree}" for degree in degrees if degree != 15),
        *(f"eagor_paper:degree={degree}" for degree in (3, 15)),
        "eagor_paper:decode=mode",
        "eagor:decode=mean",
        "eagor:shells=0",
        "eagor:wander=0",
        "eagor:jump=0",
        *(f"eagor:floor={floor}" for floor in (0.05, 0.4, 0.8)),
        *(f"eagor:temperature={beta}" for beta in (1, 3, 6)),
        *(f"eagor:neutral={neutral}" for neutral in (0.02, 0.05, 0.2)),
    )


def named(words: Sequence[str]) -> tuple[str, ...]:
    """The methods in `words`, which may also be joined by commas: ``eagor,vmf eagor:degree=7,decode=mean``."""
    found: list[str] = []
    for word in ",".join(words).split(","):
        if "=" in word and ":" not in word and found:
            found[-1] += f",{word}"  # a further setting of the same method
        elif word:
            found.append(word)
    return tuple(found)


def _like(old: Any, value: Any, key: str) -> Any:
    """`value`, perhaps text, in the type of the rule that it replaces."""
    if isinstance(old, list):
        raise EagorError(f"the rule {key} is a list of ranges; change it from Python (eagor.tasks.rules)")
    try:
        if isinstance(old, bool):
            return {"true": True, "false": False, "1": True, "0": False}[str(value).lower()]
        return type(old)(value)
    except (KeyError, ValueError):
        raise EagorError(f"{key} = {value!r}; wanted something like {old!r}") from None
