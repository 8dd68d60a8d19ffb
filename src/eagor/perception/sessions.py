"""Networks in ONNX files, run by onnxruntime: how the package opens them all."""

from __future__ import annotations

import os
from typing import Any


def session(file: str | os.PathLike[str], threads: int = 1) -> Any:
    """The network in `file`, ready to run on the CPU, on `threads` cores: the machine's others belong to the caller.

    Raises what onnxruntime raises for a file that it cannot read; the caller has checked that onnxruntime is there.
    """
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads, options.inter_op_num_threads = threads, 1
    options.log_severity_level = 3  # errors only: notes about how a file was exported help nobody here
    return onnxruntime.InferenceSession(os.fspath(file), options, providers=["CPUExecutionProvider"])
