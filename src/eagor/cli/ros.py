"""``eagor ros``: a node of ROS 2 over DDS."""

from __future__ import annotations

import math
import re
import threading
from collections.abc import Sequence
from dataclasses import replace

from eagor.cli import terminal
from eagor.cli.looking import checked_folder, checked_query, make_perception, perception_for, tracker_config
from eagor.cli.ros_options import Ros
from eagor.cli.steps import LEAST_ROWS
from eagor.errors import QueryError
from eagor.perception import is_model, rows_of
from eagor.robots.ros.graph import DdsGraph
from eagor.robots.ros.node import Node, NodeSettings
from eagor.robots.safety.walking import WalkSettings

NAME = re.compile(r"(/[A-Za-z]\w*)+")


def ros(options: Ros) -> int:
    """Run the command; returns its exit code."""
    queries = tuple(checked_query(word) for word in options.queries)
    if len({*queries}) < len(queries):
        raise terminal.UsageError("a query comes twice; name each thing once")
    name = options.name if options.name.startswith("/") else f"/{options.name}"
    if not NAME.fullmatch(name):
        raise terminal.UsageError(
            f"--name {options.name}; wanted letters, digits and _, such as /eagor or /robot1/eagor"
        )
    if options.seconds is not None and not 0 < options.seconds < math.inf:
        raise terminal.UsageError(f"--seconds {options.seconds:g}; wanted seconds above 0")
    if not 0 <= options.latency < math.inf:
        raise terminal.UsageError(f"--latency {options.latency:g}; wanted seconds, 0 or more")
    if options.record is not None:
        checked_folder(options.record, "--record")
        if options.record.exists():
            raise terminal.UsageError(f"--record {options.record} is there already; name a new folder")
    if options.cmd_vel is not None and options.poses != "odom":
        raise terminal.UsageError(
            f"--cmd-vel with --poses {options.poses}: a base is driven only by odometry; leave --poses out"
        )
    rig = None
    if options.rig is not None:
        from eagor.media.rigs import read_rig

        rig = read_rig(options.rig)
    spec = chosen(queries, options.perception) if queries else options.perception or "colour"
    config = tracker_config(options.degree, spec, options.calibration, options.detector, options.force)
    rows = max(LEAST_ROWS, 0 if is_model(spec) else rows_of(make_perception(spec)))
    settings = NodeSettings(
        image_topic=options.image_topic,
        odom_topic=options.odom_topic,
        poses=options.poses,
        body=options.body,
        camera=options.camera,
        world=options.world,
        rate=options.rate,
        belief_rate=options.belief_rate,
        belief_encoding=options.belief_encoding,
        latency=options.latency,
        rows=rows,
        patience=options.patience,
        rig=rig,
        record=options.record,
        cmd_vel=options.cmd_vel,
        walking=WalkSettings(speed=options.speed, distance=options.distance),
        config=replace(config, floor_height=options.floor),
        use_sim_time=options.use_sim_time,
    )
    with DdsGraph(options.domain, options.interface, name) as graph:
        node = Node(
            graph, queries=queries, settings=settings, said=terminal.log,
            choose=lambda words: chosen(words, options.perception),
        )  # fmt: skip
        terminal.log(
            f"node {name} on domain {graph.link.domain}, {options.interface or 'an interface of its choice'}: "
            f"directions on {name}/direction, queries on {name}/query"
        )
        if options.cmd_vel is not None:
            terminal.log(f"it DRIVES: velocities on {options.cmd_vel}; be ready to stop the base")
        timer = None
        if options.seconds is not None:
            timer = threading.Timer(options.seconds, node.stop)
            timer.daemon = True
            timer.start()
        try:
            node.run()
        finally:
            if timer is not None:
                timer.cancel()
            terminal.log(f"{node.answers} answers")
    if options.json:
        terminal.emit({"queries": list(node.queries), "answers": node.answers})
    return terminal.OK


def chosen(queries: Sequence[str], given: str | None) -> str:
    """The one perception that answers all queries. Raises `QueryError`."""
    found = {perception_for(query, given) for query in queries}
    if len(found) > 1:
        raise QueryError(
            f"{' and '.join(sorted(found))} would each answer some of the queries; name one with --perception"
        )
    return found.pop()
