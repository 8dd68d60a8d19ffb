"""DDS domains for tests: one that nobody uses, so that no test meets another's topics."""

from __future__ import annotations

import random
import socket

_BASE, _STEP, _MOST = 7400, 250, 8  # ports of domain 0, ports per domain, participants looked at (DDSI-RTPS 9.6.1.1)


def free_domain() -> int:
    """A domain on which nobody listens; chosen at random, as tests run side by side."""
    for domain in random.SystemRandom().sample(range(1, 120), 100):
        if all(_is_free(_BASE + _STEP * domain + 10 + 2 * index) for index in range(_MOST)):
            return domain
    raise RuntimeError("all DDS domains of this machine are in use")


def _is_free(port: int) -> bool:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.bind(("127.0.0.1", port))
        except OSError:
            return False
    return True
