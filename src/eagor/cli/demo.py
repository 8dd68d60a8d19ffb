"""``eagor demo``: a search in an apartment, or with ``--photo`` a camera that turns in a photograph of yours."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from tyro.conf import arg

from eagor.cli import checks, terminal
from eagor.cli.options import Common, Name, Whole, bare, refuse


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
    """The detector: auto (scout; with --photo as for locate), truth (the true places, with noise), or another."""


def demo(options: Demo) -> int:
    """Run the command; returns its exit code."""
    checks.check_outputs(options, out="folder")
    if options.photo is not None:
        found, report = _photo(options, options.photo)
        table = list[str]()
    else:
        refuse(options, ["query"], "is for --photo PICTURE; in the apartment the search is chosen by --episode")
        from eagor.cli import demo_apartment
        from eagor.lab.envs.episodes import PER_PLACE
        from eagor.lab.envs.places import SEEDS

        for name, number, count in ("seed", options.seed, SEEDS), ("episode", options.episode, PER_PLACE):
            if not 0 <= number < count:
                raise terminal.UsageError(f"--{name} {number}; wanted 0 to {count - 1}")
        perception = "scout" if options.perception == "auto" else options.perception
        checks.check_looks(perception)
        search = demo_apartment.play(options.seed, options.episode, perception, say=not options.json)
        found, report = demo_apartment.as_json(search), demo_apartment.write_report(search, options.out)
        table = [*demo_apartment.errors_table(search).lines(120), demo_apartment.STUDY_IN_WORDS, ""]
    ending = f"The report with pictures: {report}"
    return terminal.give(options.json, found | {"report": str(report)}, "", *table, *found["summary"], "", ending)


def _photo(options: Demo, path: Path) -> tuple[dict[str, Any], Path]:
    from eagor.sources.camera_sources import FrameCheck, ShapeError

    refuse(options, ("seed", "episode"), "chooses an apartment; leave it out with --photo")
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
    from eagor.drawing import BeliefPage
    from eagor.perception import short_name

    query, looks = options.query or demo_photo.best_query(perception, image), demo_photo.LOOKS
    if not options.json:
        what = f"A camera turns in {path.name} and looks {looks} times for the {query}"
        terminal.say(f"{what}, with the perception {short_name(spec)}.")
    used = {"photograph": path.name, "perception": spec, "truth": demo_photo.NO_TRUTH}
    page = BeliefPage(options.out / "report.html", query=query, used=used)
    with terminal.progress("looking", looks, shown=not options.json) as advance, page:
        played = demo_photo.play(image, perception, query, page, advance)
    return demo_photo.as_json(played, spec, path.name), page.path
