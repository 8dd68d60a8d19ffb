"""What the workers of `tests/robustness/test_processes.py` do."""

import os
import signal
import sys
import time

from eagor._processes import Worker
from eagor.errors import WorldError


def echo(line, *first):
    """Say `first`, then whatever comes, and the number of BLAS threads for "threads"."""
    for item in first:
        line.send(item)
    while True:
        item = line.recv()
        line.send(os.environ["OPENBLAS_NUM_THREADS"] if item == "threads" else item)


def fail(line, text):
    line.send("begun")
    raise WorldError(text)


def leave(line, code):
    line.recv()
    sys.exit(code)


def stay(line):
    """Neither end nor listen."""
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    line.send(os.getpid())
    while True:
        time.sleep(60)


def employ(line):
    """Start another one that stays, and say its number and our own."""
    other = Worker(stay)
    line.send((os.getpid(), other.receive()))
    line.recv()
