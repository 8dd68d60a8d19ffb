"""Runs: what was measured, kept through any crash, summed up with its uncertainty, and shown.

- `runner` carries a run out, on one worker or several; `log` keeps a line of JSON for each unit;
- `results` reads a run: values, means, intervals, paired differences; `episodes`: the steps of its episodes;
- `tables` show them; `report` puts them on a `page` and into Markdown, beside what was published (``published.toml``);
- `predictions` come as JSON lines from elsewhere and are scored;
- `calibration`: how a perception's responses are read; `labelled_looks`, `detector_fit`: a detector's model from looks
  with known truth.

Nothing heavy is imported here.
"""

__all__: list[str] = []  # the names are those of the modules
