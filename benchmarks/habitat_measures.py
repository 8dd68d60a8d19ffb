"""Our measures of navigation against habitat-lab's, on the recorded paths of a run with an episodes file.

    eagor export habitat 0-9 --out data
    eagor bench run navigation --perception truth --methods oracle eagor \
        --episodes-file data/datasets/objectnav/eagor/v1/val/val.json.gz --out runs/listed
    python benchmarks/habitat_measures.py runs/listed

habitat-lab (with Habitat-Sim, which it imports) reads the same file with its own reader. Its DistanceToGoal, Success,
SPL and SoftSPL follow each recorded path; distances along the floor are those of the world that was played in. Prints
the largest differences, and ends with exit code 1 if one is above 1e-6.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
import habitat_lab

from eagor.evaluation import studies
from eagor.evaluation.samples import finished

MOST = 1e-6


def main() -> int:
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("run", type=Path)
    options.add_argument("--scenes", type=Path, default=Path(), help="as for `eagor bench run`; nothing is read there")
    given = options.parse_args()
    if why := habitat_lab.missing():
        sys.exit(why)
    run = studies.read(given.run)
    found = habitat_lab.dataset(run.settings["episodes_file"], given.scenes)
    rows = habitat_lab.differences(run.settings, finished(run.records), found)
    print(f"{len(found.episodes)} episodes read by habitat-lab; {len(rows)} paths of {given.run}")
    worst = 0.0
    for name in next(iter(rows.values()))[1]:
        gaps = {key: abs(ours[name] - theirs[name]) for key, (ours, theirs) in rows.items()}
        key = max(gaps, key=lambda each: gaps[each])
        worst = max(worst, gaps[key])
        mean = sum(theirs[name] for _, theirs in rows.values()) / len(rows)
        print(f"  {name:17} mean {mean:8.4f}, largest difference {gaps[key]:.1e} ({key})")
    return 1 if worst > MOST else 0


if __name__ == "__main__":
    sys.exit(main())
