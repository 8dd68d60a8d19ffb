# %% [markdown]
"""A benchmark, cell by cell.

What is learnt: a run is a few settings; it is played into a folder, which can be read while it grows and goes on where
it was stopped; a table with intervals comes out. Paste the cells (`# %%`) into a notebook, or run the file. On the
command line the same is `eagor bench run tracking --perception truth --episodes 3 --seed 40`.
"""

# %% What to run: three episodes with a moving or hidden ball, a noisy simulated detector, three methods
import tempfile
from pathlib import Path

from eagor.lab.eval import tables
from eagor.lab.eval.report import write_report
from eagor.lab.eval.results import read, summarise
from eagor.lab.eval.runner import run
from eagor.lab.tasks.task import WORK, configure, load, settings_of

settings = {
    "perception": "truth",
    "episodes": 3,
    "seed": 40,  # apartments 0 to 1999 are for trying things out; results are taken from 2000 on
    "methods": ["centroid", "vmf", "eagor"],
    "rules": {"steps": 24},
}

# %% Play it. The second call finds everything done
folder = Path(tempfile.mkdtemp(prefix="eagor-example-"))
task = load("tracking")
config = configure(task, settings)
first = run(task.samples(config), WORK, settings_of(config), folder)
again = run(task.samples(config), WORK, settings_of(config), folder)
print(f"{first.done} episodes played; the second time {again.done}, since {again.skipped} are recorded already")

# %% The table, and one number out of it
played = read(folder)
summary = summarise(played)
print("\n".join(tables.as_text(played, summary)))
errors = {name: figures["error"] for name, figures in summary["methods"].items()}
print(f"mean error of eagor: {errors['eagor']:.1f} deg, of the mean pixel: {errors['centroid']:.1f} deg")

# %% One episode from the inside: the record holds every step
record = played.records[0]
trace = record["methods"]["eagor"]["trace"]
steps = [f"{error:.0f}" for error in trace["error_deg"] if error is not None]
print(f"episode {record['episode']['id']} ({record['episode']['query']}), error by step: {' '.join(steps)}")

# %% The report, with pictures: open it in a browser
print(f"the report: {write_report(folder)}")
