"""The options of ``eagor studio``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar

from tyro.conf import Positional, arg

from eagor.cli.shared_options import Common, Flag, RigFile, bare


@dataclass(frozen=True, kw_only=True)
class Studio(Common):
    """Open a page in the browser: walk in an apartment, look through runs and pictures, watch a camera, live.

    `eagor studio export RUN --out page.html` writes one episode of a run as a page that needs no server.
    """

    runs: ClassVar[str] = "eagor.cli.studio:studio"

    words: Annotated[tuple[str, ...], Positional, bare("[export RUN]")] = ()
    """Nothing, for the page; or: export, and the folder of a run."""
    port: Annotated[int, arg(metavar="N")] = 8360
    """Port to listen at; 0: any free one."""
    open: Flag = False
    """Open the page in the browser of this desktop."""
    host: Annotated[str, arg(metavar="ADDRESS")] = "127.0.0.1"
    """Address to listen at. Other machines reach the page only with another one, which needs --token."""
    token: Annotated[str | None, bare("TEXT")] = None
    """What everybody has to know who opens the page (at least 16 letters); auto: one is made and printed."""
    folder: Annotated[Path, arg(name="runs", metavar="DIR")] = Path("runs")
    """The folder with the runs to choose from; the folder of a run itself works, too."""
    perception: Annotated[str | None, bare("NAME")] = None
    """A further detector to choose, as for locate; --source looks with it (default: as for live)."""
    seed: Annotated[int, arg(metavar="N")] = 602
    """The apartment that is built first, 0 to 9999."""
    source: Annotated[str | None, bare("SOURCE")] = None
    """A live camera, a video, a folder or a bag to watch, as for live."""
    query: Annotated[str | None, bare("QUERY")] = None
    """With --source: what to look for at first."""
    poses: Annotated[str, arg(metavar="SOURCE")] = "auto"
    """With --source: how the camera turns and moves, as for live (auto, level, still, ros:/odom, go2, CSV)."""
    rig: RigFile = None
    out: Annotated[Path | None, bare("FILE.html")] = None
    """With export: the page to write."""
    episode: Annotated[str | None, bare("NAME")] = None
    """With export: the episode, as bench failures names it (default: the worst one)."""
    methods: Annotated[tuple[str, ...], bare("NAME ...")] = ()
    """With export: the methods to show (default: all that the run has, at most 8)."""
