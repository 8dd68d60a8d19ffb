"""ROS 2 bags without ROS: recordings of topics, read (`reader`) and written (`writer`).

`messages`: to and from our types. `storage`: the two kinds of files, read within bounds.
"""

from __future__ import annotations

from eagor.media.bags.reader import read_bag
from eagor.media.bags.writer import BagWriter

__all__ = ["BagWriter", "read_bag"]
