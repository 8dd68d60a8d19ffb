"""Reads logs of the Rerun viewer, for tests."""

from __future__ import annotations

import numpy as np


def read(path) -> dict[str, list[tuple[float, np.ndarray]]]:
    """Each component by entity and name, with its times in seconds."""
    from rerun.chunk import RrdReader

    found: dict[str, list[tuple[float, np.ndarray]]] = {}
    for chunk in RrdReader(path).stream():
        batch = chunk.to_record_batch()
        names = batch.schema.names
        times = None
        if "time" in names:
            column = batch.column("time").cast("int64")
            times = np.array(column.to_pylist(), dtype=float) / 1e9
        for name in names:
            if ":" not in name:
                continue
            for row, value in enumerate(batch.column(name).to_pylist()):
                if value is not None:
                    at = np.nan if times is None else times[row]
                    found.setdefault(f"{chunk.entity_path} {name}", []).append((at, np.array(value, dtype=object)))
    return found
