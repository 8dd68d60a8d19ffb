"""Runs: what was measured, kept through any crash, summed up with its uncertainty, and shown.

- `study`: the one Protocol that simulated tasks (`simulated`) and benchmarks with published data (`benchmarks`) fill;
  `studies` finds them;
- `bench`, `benchmarks`: a run's settings and units; `workers` does the `units`, and `ledger` keeps a line of JSON each;
- `samples`: means, intervals and paired differences; of them `tables` and `scores` make the figures of a run, and
  `comparison` those of two; `predictions`: what others answered;
- `report`: the page (`page`, `charts`, `figures`, `scenes`, `searched`), Markdown, LaTeX and CSV (`export`) of a run,
  and its tables (`sheets`, `benchmark_sheets`), beside what was `published`;
- `calibration`, `fitting`: how a perception's responses are read; `labelled`: panoramas with labels;
- `labelled_looks`, `detector_fit` (`detector_em`, `detector_places`, `score_curve`): a detector's model from looks with
  known truth; `replayed`: such looks from files; `detector_unlabelled`: from looks without it.

Nothing heavy is imported here.
"""

__all__: list[str] = []  # the names are those of the modules
