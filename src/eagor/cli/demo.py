"""``eagor demo``: a search in an apartment, or with ``--photo`` a camera that turns in a photograph of yours."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import arg

from eagor.cli import checks, terminal
from eagor.cli.options import Common, Name, Whole, bare, given


@dataclass(frozen=True, kw_only=True)
class Demo(Common):
    """Search in a furnished apartment, or in a photograph of yours, and write a report with pictures."""

    photo: Annotated[Path | None, bare("PICTURE")] = None
    """Turn a camera in this panorama of yours, an equirectangular image, instead of walking in an apartment."""
    query: Annotated[str | None, bare("QUERY")] = None
    """With --photo: what to look for (default: what the detector finds in one place)."""

    out: Annotated[Path, arg(metavar="DIR")] = Path("eagor-demo")
    """Folder for the report and the pictures."""
    seed: Whole = 14
    """Seed of the apartment, 0 to 9999; by default one that shows what memory is for."""
    episode: Whole = 1
    """Search in this apartment, 0 to 4."""
    perception: Name = "auto"
    (
        "The detector: auto (in the apartment scout, a small network on the rendered pictures; with --photo as for "
        "locate), truth (a noisy detector with the simulator's ground truth), or another perception."
    )


def demo(options: Demo) -> int:
    """Run the command; returns its exit code."""
    if options.photo is not None:
        return _photo(options, options.photo)
    if options.query is not None:
        raise terminal.UsageError("--query is for --photo PICTURE; in the apartment the search is chosen by --episode")
    from eagor.cli import demo_apartment
    from eagor.lab.envs.episodes import PER_PLACE
    from eagor.lab.envs.places import SEEDS

    if not 0 <= options.seed < SEEDS:
        raise terminal.UsageError(f"--seed {options.seed}; wanted an apartment, 0 to {SEEDS - 1}")
    if not 0 <= options.episode < PER_PLACE:
        raise terminal.UsageError(f"--episode {options.episode}; wanted 0 to {PER_PLACE - 1}")
    checks.check_outputs(options, out="folder")
    perception = "scout" if options.perception == "auto" else options.perception
    checks.check_looks(perception)
    search = demo_apartment.play(options.seed, options.episode, perception, say=not options.json)
    found = demo_apartment.as_json(search) | {"report": str(demo_apartment.write_report(search, options.out))}
    table = [*demo_apartment.as_text(search), "", demo_apartment.STUDY_IN_WORDS]
    return _told(options, found, demo_apartment.summary(search), table)


def _photo(options: Demo, path: Path) -> int:
    from eagor.perception import short_name
    from eagor.sources.camera_sources import FrameCheck, ShapeError

    if mistaken := given(options, ("seed", "episode")):
        raise terminal.UsageError(f"--{mistaken[0]} chooses an apartment; leave it out with --photo")
    checks.check_outputs(options, out="folder")
    spec = options.perception
    if spec == "auto":  # without a query the detector chooses one, so it has to be one that knows things
        spec = "coco" if options.query is None else checks.perception_for([checks.checked_query(options.query)], None)
    checks.check_looks(spec)
    try:
        image = FrameCheck(say=terminal.log).read(path).picture
    except ShapeError as error:
        raise ShapeError(f"{re.split('[;.] ', str(error))[0]}; wanted a whole panorama: pad it to 2:1 first") from None
    perception = checks.make_perception(spec)
    from eagor.cli import demo_photo

    query = options.query or demo_photo.best_query(perception, image)
    if not options.json:
        what = f"A camera turns in {path.name} and looks {demo_photo.LOOKS} times"
        print(f"{what} for the {query}, with the perception {short_name(spec)}.", flush=True)
    with terminal.progress("looking", demo_photo.LOOKS, shown=not options.json) as advance:
        played = demo_photo.play(image, perception, spec, query, advance)
    report = demo_photo.write_report(played, spec, path.name, options.out)
    found = demo_photo.as_json(played, spec, path.name) | {"report": str(report)}
    return _told(options, found, [], demo_photo.summary(played))


def _told(options: Demo, found: dict[str, str], above: list[str], below: list[str]) -> int:
    return terminal.give(
        options.json, found, "", *above, "", *below, "", f"The report with pictures: {found['report']}"
    )
