"""An episode of a run of a simulated task, played again: every method sees again what it saw in the run."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from eagor.errors import EagorError
from eagor.lab.agents.methods import TrackerEstimator
from eagor.lab.envs.episodes import PER_PLACE, EpisodeSpec, spec_from_json
from eagor.lab.eval.results import Run, rank
from eagor.lab.tasks.sim.play import Runner, StepInfo
from eagor.lab.tasks.task import finished, sample_of

LOGGED_ROWS = 256  # of panoramas of an episode that is logged


def runner_of(run: Run, case: str) -> tuple[Runner, EpisodeSpec]:
    """What plays a case of a run again, and its spec. Raises as `spec_in`."""
    spec = spec_in(run, case)
    return Runner(dict(run.settings)), spec


def spec_in(run: Run, case: str) -> EpisodeSpec:
    """The spec of a case of a run. Raises `EagorError` for answers to published data, or an unknown case."""
    if not run.simulated:
        raise EagorError(f"only episodes of simulated tasks can be played again, and {run.task.name} has none")
    record = next((record for record in finished(run.records) if sample_of(record) == case), None)
    if record is None:
        names = ", ".join(dict.fromkeys(sample_of(record) for record in finished(run.records)))
        raise EagorError(f"the run has no case {case!r}; it has {names[:200] or 'none'}")
    episode, first = record["episode"], run.settings.get("seed")
    if "slot" in episode:  # of an episode that a file lists
        return spec_from_json(episode["slot"])
    world, seed, index = (episode.get(key) for key in ("world", "seed", "index"))
    if not (isinstance(world, str) and all(isinstance(value, int) for value in (first, seed, index))):
        raise EagorError(f"the record {record['key']!r} does not say which episode it is of; it cannot be played again")
    number = (seed - first) * PER_PLACE + index  # by which some tasks deal their scenarios
    return EpisodeSpec(run.task.name, world, seed, index, number)


def log_case(run: Run, method: str, case: str | None, path: str | Path) -> str:
    """Play a case of a run (None: the worst one) again and log it for the Rerun viewer; returns its name.

    Raises `EagorError` as `runner_of`, or for a method that has no belief (ours and its variants have one).
    """
    from eagor.drawing.rerun_log import RerunLog

    ranked = [sample_of(result.record) for result in rank(run, method)] if run.simulated else []
    name = case or (ranked[-1] if ranked else "")
    runner, spec = runner_of(run, name)
    if not isinstance(runner.method(method, spec), TrackerEstimator):
        raise EagorError(f"{method} keeps no belief that could be logged; give --method eagor, or a variant of it")
    query = str(runner.plan(spec).query)
    with RerunLog(path, f"{run.task.name} {name}: {query}") as log:

        def add(step: StepInfo) -> Any:
            assert isinstance(step.method, TrackerEstimator)
            log.add(
                step.picture(LOGGED_ROWS), step.method.estimate, stamp=step.stamp, query=query, position=step.position,
                truth=step.truth,
            )  # fmt: skip

        runner.run_episode(spec, [method], add)
    return name
