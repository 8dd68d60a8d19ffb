"""Runs: what was measured, kept through any crash, summed up with its uncertainty, and shown.

- `ledger`: one line of JSON per finished unit of work, in a run folder;
- `workers`: the units of a run on one or several processes, which may die and be started again;
- `tables`: records to rows, with intervals and differences; `published`: the paper's figures to hold them against;
- `report`: the page, the Markdown and the CSV of a run.

`curves`, `kernels`, `charts`, `scenes` and `page` are the report's parts. Nothing heavy is imported here.
"""
