"""Runs: what was measured, kept through any crash, summed up with its uncertainty, and shown.

`runner` carries a run out, `log` keeps it, `results` sum it up, `tables` and `report` show it, on a `page` and beside
what was published (``published.toml``); `predictions` of others are scored. `calibration`, `labelled_looks` and
`detector_fit` fit a perception's model. Nothing heavy is imported here.
"""

__all__: list[str] = []  # the names are those of the modules
