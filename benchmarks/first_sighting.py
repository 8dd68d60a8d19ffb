"""Errors after the first sighting: what each method makes of one body's looks, beside each single look's own answer.

    python benchmarks/first_sighting.py [--perception scout] [--episodes 60] [--seed 1600] [--methods eagor vmf]

The searching body of Map-Free Navigation walks by `eagor`, and its looks are written down. Every method then gets the
same looks. `frame` answers with the highest value of the newest response map and remembers nothing: what the perception
alone says. Columns: degrees of error after the first sighting, of these while the target is in sight, and while it is
hidden again; means over episodes of the mean over steps, with 95 % intervals over apartments. `- frame`: the same after
the first sighting, less that of `frame`, paired by episode.
"""

from __future__ import annotations

import math

import common
import numpy as np

from eagor.lab.envs.episodes import EpisodeSpec, episode_specs
from eagor.lab.tasks.sim.rollout import Runner, Step
from eagor.metrics import angular_error_deg

OURS, FRAME = "eagor", "frame"


def frame_errors(steps: list[Step]) -> np.ndarray:
    """Degrees ``(n,)`` between the truth and the highest value of each look; NaN where there is no response map."""
    found = np.full(len(steps), math.nan)
    for index, step in enumerate(steps):
        if step.evidence is not None and step.evidence.response is not None:
            best = step.evidence.grid.directions.reshape(-1, 3)[int(np.argmax(step.evidence.response))]
            found[index] = angular_error_deg(best, step.truth)
    return found


def errors(runner: Runner, name: str, spec: EpisodeSpec, steps: list[Step]) -> np.ndarray:
    """Degrees ``(n,)`` of error of a method after each look."""
    if name == FRAME:
        return frame_errors(steps)
    method = runner.method(name, spec)
    answers = [step.answered_by(method) for step in steps]
    return np.array([float(angular_error_deg(answer, step.truth)) for answer, step in zip(answers, steps, strict=True)])


def means(errors: np.ndarray, visible: list[bool]) -> list[float]:
    """The mean after the first sighting, in sight, and hidden again; NaN where the episode has no such step."""
    here, since = np.array(visible), np.logical_or.accumulate(visible)
    kept = [errors[chosen & np.isfinite(errors)] for chosen in (since, here, since & ~here)]
    return [float(part.mean()) if len(part) else math.nan for part in kept]


def main() -> None:
    methods = [OURS, "vmf", "grid_filter"]
    given = common.parser(__doc__, perception="scout", episodes=60, seed=1600, methods=methods).parse_args()
    runner = Runner({"task": "navigation", "perception": given.perception})
    names, rows, seeds, pointed = [FRAME, *given.methods], [], [], []
    for spec in episode_specs("navigation", given.episodes, given.seed):
        steps: list[Step] = []
        record = runner.run_episode(spec, [OURS], steps.append)
        visible = record["methods"][OURS]["trace"]["visible"]
        found = {name: errors(runner, name, spec, steps) for name in names}
        rows.append([means(found[name], visible) for name in names])
        seeds.append(spec.seed)
        if any(visible):
            pointed.append(float((found[FRAME][visible] < 15).mean()))
    table = np.array(rows)
    print(f"{given.perception}: {given.episodes} episodes; a look points within 15 degrees of what is in sight in "
          f"{100 * np.mean(pointed):.1f} % of the cases")  # fmt: skip
    print(f"{'':24s}{'after the first':>22s}{'in sight':>22s}{'hidden again':>22s}{'- frame':>22s}")
    for index, name in enumerate(names):
        columns = [*table[:, index].T, *([table[:, index, 0] - table[:, 0, 0]] if index else [])]
        print(f"{name:24s}" + "".join(f"{common.shown(column, groups=seeds):>22s}" for column in columns))


if __name__ == "__main__":
    main()
