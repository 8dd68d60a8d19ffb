"""Work for the workers of tests: importable in a new process, and quick to import."""

import os
import time
from pathlib import Path


def squares(config):
    """Squares numbers; some payloads ask for trouble. `config["notes"]` is a folder for what must outlive a process."""
    notes = Path(config["notes"])

    def do(payload):
        number, trouble = payload
        times = len(list(notes.glob(f"{number}-*"))) + 1
        (notes / f"{number}-{times}-{os.getpid()}").touch()
        time.sleep(config.get("sleep", 0.0))
        if trouble == "raise" or (trouble == "raise once" and times == 1):
            raise ValueError(f"cannot square {number}")
        if trouble == "die" or (trouble == "die once" and times == 1):
            os._exit(7)
        if trouble == "kill":
            os.kill(os.getpid(), 9)
        if trouble == "nan":
            return {"methods": {"ours": {"metrics": {"square": float("nan")}}}}
        return {
            "methods": {"ours": {"metrics": {"square": number**2}}},
            "threads": os.environ.get("OPENBLAS_NUM_THREADS"),
            "process": os.getpid(),
        }

    return do


def hopeless(config):
    """Cannot be set up."""
    raise RuntimeError("no such world")


def stillborn(config):
    """Takes its process down before the work begins."""
    os._exit(3)
