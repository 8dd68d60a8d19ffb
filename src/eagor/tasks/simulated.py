"""The three built-in tasks: their environments, measures, and the columns of their tables.

The columns are those of the paper's tables where it has them. Their meaning is given here and in `measure` of
`eagor.tasks.waypoint`, `navigation` and `tracking`.
"""

from __future__ import annotations

from eagor.tasks import listed_episode, navigation, tracking, waypoint
from eagor.tasks.environments import MapFreeNavigationEnv, TargetTrackingEnv, WaypointFollowingEnv
from eagor.tasks.rules import NavigationRules, TrackingRules, WaypointRules
from eagor.tasks.task import Column, Task

COVERAGE = Column(
    "coverage", "Coverage", "%", None, "coverage", "share of steps with the truth inside the 90 % region; 90 is right",
    scale=100.0,
)  # fmt: skip
_TC = "jump of the estimate from step to step that the true motion does not explain"
_CALM = "an estimate that hardly moves hardly jumps: compare the errors, too"
_HOLD = (
    "a filter with a short memory gives up the old place sooner; ours weighs all past evidence, which keeps hidden "
    "targets"
)


WAYPOINT = Task(
    name="waypoint",
    title="Waypoint Following",
    what="name the direction at every step of a given route of four legs",
    environment=WaypointFollowingEnv,
    rules=WaypointRules,
    measure=waypoint.measure,
    columns=(
        Column("L1", "L1", "°", "low", "L1", "mean error on the first leg"),
        Column("L2", "L2", "°", "low", "L2", "mean error on the second leg"),
        Column("L3", "L3", "°", "low", "L3", "mean error on the third leg"),
        Column("L4", "L4", "°", "low", "L4", "mean error on the fourth leg"),
        Column("delta", "Δ", "°", "low", "delta", "growth of the error, L4 minus L1, mean over the episodes"),
        Column("occ", "Occ", "°", "low", "occ", "mean error while the target is hidden"),
        Column("seam", "Seam", "°", "low", "seam", "mean error where the true bearing crosses the seam"),
        Column("tc", "TC", "°/step", "low", "tc", f"{_TC} (rotation and translation)", why=_CALM),
        Column(
            "tc_rotation", "TC, rotation", "°/step", "low", "tc_rotation",
            f"{_TC} (rotation alone: parallax counts as a jump, so an estimate that ignores it scores low)",
            why="it rewards an estimate that ignores parallax: the paper defines it so, we do not optimise it",
        ),
        COVERAGE,
    ),
    headline="L4",
)  # fmt: skip

NAVIGATION = Task(
    name="navigation",
    title="Map-Free Navigation",
    what="start facing away from the thing, and search and walk until it is reached",
    environment=MapFreeNavigationEnv,
    rules=NavigationRules,
    measure=navigation.measure,
    columns=(
        Column("sr", "SR", "%", "high", "success", "episodes that end at the target", scale=100.0, share=True),
        Column("spl", "SPL", "%", "high", "spl", "success weighted by path length", scale=100.0),
        Column("soft_spl", "SoftSPL", "%", "high", "soft_spl", "progress weighted by path length", scale=100.0),
        Column("steps", "Steps", "", "low", "steps", "mean number of steps"),
        Column("undone", "Undone", "%", "low", "undone", "steps that lead back to where the body was", scale=100.0),
        Column("mae", "MAE", "°", "low", "mae", "mean direction error"),
        Column(
            "seam_success", "Seam", "%", "high", "success", "success where the true bearing crossed the seam",
            scale=100.0, share=True, only_if="seam_crossings",
        ),
        COVERAGE,
    ),
    headline="sr",
    strata={"visible": "Target in sight at the start", "way": "Way to the target"},
    walked=True,
    listed=listed_episode.plan,
)  # fmt: skip

TRACKING = Task(
    name="tracking",
    title="Target Direction Estimation",
    what="name the direction of a ball that moves, or is away, or that the camera walks past",
    environment=TargetTrackingEnv,
    rules=TrackingRules,
    measure=tracking.measure,
    columns=(
        Column("error", "Error", "°", "low", "error", "mean direction error"),
        Column("tc", "TC", "°/step", "low", "tc", f"{_TC} (rotation and translation)", why=_CALM),
        Column("time_lost", "Time lost", "%", "low", "time_lost", "share of steps at which the target is lost"),
        Column(
            "recovery", "Recovery", "s", "low", "recovery", "from the target's return until it is found again",
            why=_HOLD,
        ),
        COVERAGE,
    ),
    headline="error",
    strata={"scenario": "Scenario"},
)  # fmt: skip
