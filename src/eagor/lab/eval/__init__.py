"""Runs: what was measured, kept through any crash, summed up with its uncertainty, and shown.

- `study`: the one Protocol that simulated tasks (`simulated`) and benchmarks with published data (`benchmarks`) fill,
  with their runs' settings and units, and what a run is written as; `studies` finds them, reads a run, writes its
  report and compares two;
- `runner` carries a run out, on one worker or several; `log` keeps a line of JSON for each unit;
- `samples`: records, checked; means, intervals and paired differences. Of them `tables` and
  `benchmark_tables` make the figures of a run;
- the report: a page (`page`, `sheets`, `scenes`), Markdown, LaTeX and CSV, beside what was published
  (``published.toml``);
- `calibration`: how a perception's responses are read;
- `labelled_looks`, `detector_fit`: a detector's model from looks with known truth.

Nothing heavy is imported here.
"""

__all__: list[str] = []  # the names are those of the modules
