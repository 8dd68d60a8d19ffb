"""Runs: what was measured, kept through any crash, summed up with its uncertainty, and shown.

- `ledger`: one line of JSON (`lines`) per finished unit of work, in a run folder;
- `workers`: the `units` of a run on one or several processes (`crew`), which may die and be started again, on threads
  (`fanout`), or on a cluster (`ray_engine`);
- `bench`: runs of simulated tasks; `tables`: their records to rows, with intervals and differences (`samples`);
  `published`: the paper's figures to hold them against; `report`: the page, the Markdown and the CSV of a run;
- `benchmarks`: runs of benchmarks with published data; `predictions`: what others answered; `scores`: records to
  figures; `published_search`; `benchmark_report`;
- `calibration` and `fitting`: how a perception's responses are read; `lasting`: how long its mistakes last;
  `labelled`: panoramas with labels.

`sheets`, `benchmark_sheets`, `figures`, `curves`, `parts`, `kernels`, `charts`, `scenes`, `page` and `export` are the
reports' parts. Nothing heavy is imported here.
"""

__all__: list[str] = []  # the names are those of the modules
