"""Runs: what was measured, kept through any crash, summed up with its uncertainty, and shown.

- `study`: the one Protocol that simulated tasks (`simulated`) and benchmarks with published data (`benchmarks`) fill;
  `studies` finds them, reads a run and writes its report;
- `bench`, `benchmarks`: a run's settings and units; `workers` carries it out, alone or with a `worker_pool`
  (`ray_workers`), and `ledger` keeps a line of JSON for each unit;
- `record_shapes`, `samples`: records, checked; means, intervals and paired differences. Of them `tables` and
  `benchmark_tables` make the figures of a run, and `comparison` those of two; `predictions`: what others answered;
- the report: a page (`page`, `sheets`, `charts`, `traces`, `figures`, `scenes`), Markdown, LaTeX and CSV (`export`),
  beside what was `published`;
- `calibration`: how a perception's responses are read;
- `labelled_looks`, `detector_fit` (`detector_em`, `detector_places`): a detector's model from looks with known truth;
  `detector_unlabelled`: from looks without it.

Nothing heavy is imported here.
"""

__all__: list[str] = []  # the names are those of the modules
