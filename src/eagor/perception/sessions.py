"""Networks in ONNX files, run by onnxruntime: how the package opens and runs them all.

A file may come from anywhere. Its weights come from its own folder alone, and a run ends after `SECONDS`.
"""

from __future__ import annotations

import mmap
import os
import threading
from collections.abc import Mapping
from pathlib import Path
from typing import Any

SECONDS = 120.0  # that one run may take; the slowest detectors take some seconds on a robot


def session(file: str | os.PathLike[str], threads: int = 1) -> Any:
    """The network in `file`, ready to run on the CPU, on `threads` cores: the machine's others belong to the caller.

    Raises `ValueError` for weights beside the file that lie elsewhere, and what onnxruntime raises for a file that it
    cannot read; the caller has checked that onnxruntime is there.
    """
    import onnxruntime

    if strange := _stranger(Path(file)):
        raise ValueError(f"it names {strange} beside it, which is a link out of its folder, or no file")
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads, options.inter_op_num_threads = threads, 1
    options.log_severity_level = 4  # only what ends the process: notes on an export help nobody, faults are raised
    return onnxruntime.InferenceSession(os.fspath(file), options, providers=["CPUExecutionProvider"])


def run(network: Any, feed: Mapping[str, Any], seconds: float | None = None) -> list[Any]:
    """All outputs of a `session` for `feed`, by name of the input.

    Raises `TimeoutError` after `seconds` (default: `SECONDS`), else what onnxruntime raises.
    """
    import onnxruntime

    options, most = onnxruntime.RunOptions(), SECONDS if seconds is None else seconds
    options.log_severity_level = 4

    def end() -> None:
        options.terminate = True

    timer = threading.Timer(most, end)
    timer.daemon = True
    timer.start()
    try:
        return network.run(None, feed, options)
    except Exception as error:
        if options.terminate:
            raise TimeoutError(f"it has not ended after {most:g} seconds") from error
        raise
    finally:
        timer.cancel()


def _stranger(file: Path) -> Path | None:
    """What the model may read as weights and is not in its folder: a link that leads out of it, a pipe, a device.

    A model with weights elsewhere says "location" and their path; other models are not looked at further. Caches of
    downloads keep the model itself and its weights as links into one other folder; these are fine.
    """
    if not file.stat().st_size:
        return None
    with file.open("rb") as opened, mmap.mmap(opened.fileno(), 0, access=mmap.ACCESS_READ) as content:
        if content.find(b"location") < 0:
            return None
        homes = {Path(os.path.realpath(file.parent)), Path(os.path.realpath(file)).parent}
        folders = [file.parent]
        while folders:
            for entry in folders.pop().iterdir():
                if entry.name == file.name or content.find(os.fsencode(entry.name)) < 0:
                    continue
                if entry.is_dir() and not entry.is_symlink():
                    folders.append(entry)
                    continue
                real = Path(os.path.realpath(entry))
                if homes.isdisjoint(real.parents) or not (real.is_dir() or real.is_file()):
                    return entry
    return None
