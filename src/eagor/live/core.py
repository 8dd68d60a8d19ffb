"""The live loop without threads, clocks and devices: events in, answers out.

The same events give the same answers, bit for bit. Nothing here reads a clock: time is what the events say.
"""

from __future__ import annotations

import bisect
import math
import warnings
from collections import defaultdict, deque
from dataclasses import dataclass, field, replace
from statistics import median

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from eagor._checks import checked_stamp
from eagor.errors import EagorError, TimeError
from eagor.evidence import Evidence
from eagor.live.events import (
    Answer,
    Diagnostic,
    Event,
    Fault,
    ImageReceived,
    ObservationReceived,
    OdometryReset,
    Part,
    PoseReceived,
    QueriesChanged,
    Tick,
)
from eagor.odometry.clocks import ClockSync
from eagor.sources import Pose
from eagor.tracking import DirectionTracker, Estimate, TrackerConfig
from eagor.tracking.tracks import State

__all__ = ["LiveCore", "LoopSettings", "RecentPoses", "deviation", "warm"]

RECENT = 2.0  # seconds over which extrapolations are tried
LONGEST_TRIAL = 1.0  # seconds: longer extrapolations are not tried
TRIALS = 16
TRIED_POSES = 64  # that are looked at, evenly spaced
DEVIATION_STEP = 1.2  # deviations are rounded to powers of this, so that answers can share what they compute
LEAST_DEVIATION = math.radians(0.2)  # a smaller deviation counts as 0
UNKNOWN_TURN = math.pi / 2  # radians: nothing is known of the direction any more

UNSURE = math.radians(10)  # of a pose: a look from there says nothing of directions
HELD = 0.05  # seconds that the newest pose may be old without a word
STARTING = 1.0  # seconds that the first pose may take
STALE_POSE = STALE_IMAGE = 1.0  # seconds without one that are worth words of their own
STALE_LOOK = 5.0  # seconds since the newest look
INTERVALS = 2.5  # between pictures, or poses, if that is longer: slow ones are not stale
BEATS = 9  # intervals between poses of which the middle one counts
TOGETHER = 0.2  # seconds: looks that come faster are taken in together
REFRESHED = 0.4  # seconds for which a belief may only be turned with the camera before it is computed anew,
MOVED = 0.1  # ... unless the camera has gone so many metres meanwhile: near things are elsewhere by then
WAITING = 0.5  # seconds that a look may wait for the pose of its picture, if others are known
FUTURE = 0.1  # seconds by which evidence may be ahead of time
PICTURES = 512  # stamps of pictures that are remembered, for evidence that comes late
SLOWEST = 1.0  # seconds: a camera's quickest picture takes no longer; a larger difference is one of clocks
ONE_CLOCK = 0.5  # seconds: two clocks that differ by less from ours, in the same sense, are one
TOLD = 5.0  # seconds for which an event of a moment (a clock that jumped) stays among the faults


class RecentPoses:
    """Orientations of the last seconds: where the camera points after the newest, and how far that may be wrong.

    How well a camera can be foretold is seen in its own poses: the same extrapolation from earlier poses is compared
    with the poses that came later. So a camera on wheels is foretold better than one in a hand, and late poses cost
    more. `acceleration`: see `LoopSettings`.
    """

    def __init__(self, acceleration: float) -> None:
        self.acceleration = acceleration
        self._stamps: list[float] = []
        self._poses: list[np.ndarray] = []
        self._known: tuple[float, tuple[np.ndarray, float]] | None = None  # what was asked last

    def add(self, stamp: float, world_R_body: np.ndarray) -> None:
        """The next pose; stamps rise."""
        self._known = None
        self._stamps.append(stamp)
        self._poses.append(world_R_body)
        old = bisect.bisect_left(self._stamps, stamp - RECENT - 2 * LONGEST_TRIAL)
        del self._stamps[:old], self._poses[:old]

    def clear(self) -> None:
        """Later poses have nothing to do with those so far."""
        self._known = None
        self._stamps.clear()
        self._poses.clear()

    def after(self, seconds: float) -> tuple[np.ndarray, float]:
        """`world_R_body` ``(3, 3)`` so many seconds after the newest pose, and the deviation (radians per axis).

        The camera holds the newest pose, or turns on as fast as it did over the same time before: whichever would have
        missed its later poses by less. The root mean square of these misses, with that of `acceleration` as one more,
        is the deviation. It is taken for that of a turn across the line of sight, which moves what is seen the most.
        """
        if self._known is None or self._known[0] != seconds:
            self._known = seconds, self._after(seconds)
        return self._known[1]

    def _after(self, seconds: float) -> tuple[np.ndarray, float]:
        if not self._poses:
            return np.eye(3), 0.0
        newest, count = self._poses[-1], len(self._poses)
        if seconds <= 0:
            return newest, 0.0
        if count < 3:
            return newest, deviation((0.5 * self.acceleration * seconds * seconds) ** 2 / 2)
        # What is longer than can be tried goes on at the same rate, and what it misses grows with the square of time.
        tried = min(seconds, LONGEST_TRIAL, (self._stamps[-1] - self._stamps[0]) / 3)
        longer = seconds / tried
        span = max(tried, (self._stamps[-1] - self._stamps[0]) / (count - 1))
        guessed = (0.5 * self.acceleration * tried * (tried + span)) ** 2
        unseen = (0.5 * self.acceleration * (seconds - tried) ** 2) ** 2
        first = min(bisect.bisect_left(self._stamps, self._stamps[-1] - RECENT - tried - span), count - 3)
        chosen = np.unique(np.linspace(first, count - 1, TRIED_POSES).astype(int))
        stamps = np.array([self._stamps[index] for index in chosen])
        # The last start is the newest pose, of which only the turn before it is known.
        starts = np.append(np.linspace(stamps[0] + span, stamps[-1] - tried, TRIALS), stamps[-1])
        times = np.clip(starts + np.array([[-span], [0.0], [tried]]), stamps[0], stamps[-1])  # for what rounding adds
        slerp = Slerp(stamps, Rotation.from_matrix(np.array([self._poses[index] for index in chosen])))
        before, here, there = np.split(slerp(times.ravel()).as_quat(), 3)
        before, here, there = map(Rotation.from_quat, (before, here, there[:-1]))
        turns = (before.inv() * here).as_rotvec() * (tried / span)
        held, turned = ((guess[:-1].inv() * there).magnitude() for guess in (here, here * Rotation.from_rotvec(turns)))
        held, turned = (float((guessed + misses @ misses) / (TRIALS + 1)) for misses in (held, turned))
        found = here[-1] if held <= turned else here[-1] * Rotation.from_rotvec(turns[-1] * longer)
        return found.as_matrix(), deviation((min(held, turned) * longer**4 + unseen) / 2)


def deviation(variance: float) -> float:
    """The root of a variance, rounded, so that what is computed for one can be used for the next."""
    root = math.sqrt(variance)
    if root < LEAST_DEVIATION:
        return 0.0
    steps = round(math.log(root / LEAST_DEVIATION, DEVIATION_STEP))
    return min(LEAST_DEVIATION * DEVIATION_STEP**steps, UNKNOWN_TURN)


@dataclass(frozen=True)
class LoopSettings:
    """What a core starts with: `queries`, the tracker's `config`, whether `poses` are expected, the camera's `latency`.

    Without poses the camera is taken to stand still. `latency`: seconds by which the camera's stamps are set back.
    `acceleration`: radians per second squared (root mean square) by which the camera may turn faster or slower. The
    poses tell more: this counts as one observation beside many, and alone where there are too few. `extrapolate`:
    answers are those of the time that is asked for; otherwise those of the newest pose. `exact`: compute every answer
    anew, however long it takes.
    """

    queries: tuple[str, ...]
    config: TrackerConfig = field(default_factory=TrackerConfig)
    poses: bool = True
    latency: float = 0.0
    acceleration: float = 0.5
    extrapolate: bool = True
    exact: bool = False


@dataclass(eq=False)
class _Target:
    """What is known of a query: the stamp of its newest look, the last answer that was `computed`, and from where."""

    looked: float = -math.inf
    fresh: bool = False  # whether there are looks that are not in `computed`
    taken: float = -math.inf  # when looks were taken in last
    computed: Estimate | None = None
    position: np.ndarray | None = None


class LiveCore:
    """Follows targets by `settings`, event by event. Not for several threads, except `orientation`.

    A belief is computed anew with a new look, but at most every `TOGETHER` seconds, and without one when the camera has
    moved by `MOVED` or after `REFRESHED` seconds. In between it is turned with the camera, which is exact for turns and
    cheap. After the newest pose the camera's turn is extrapolated, and regions are wider by what that may miss.
    """

    def __init__(self, settings: LoopSettings) -> None:
        self.config, self.queries, self.has_poses = settings.config, settings.queries, settings.poses
        self._camera = ClockSync("camera", settings.latency, SLOWEST)
        self._odometry = ClockSync("odometry")
        self._tracker = DirectionTracker(settings.config)
        self._recent = RecentPoses(settings.acceleration)
        self._extrapolates, self._exact = settings.poses and settings.extrapolate, settings.exact
        self._pictures: deque[tuple[float, float]] = deque(maxlen=PICTURES)  # stamp of the source, and ours
        self._spreads: deque[tuple[float, float]] = deque(maxlen=PICTURES)  # of poses, by stamp
        self._first, self._pose = math.inf, -math.inf  # stamps of the first pose and of the newest
        self._image, self._interval = -math.inf, 0.0  # stamp of the newest picture, and seconds from the one before
        self._beats: deque[float] = deque(maxlen=BEATS)  # seconds between poses
        self._targets: defaultdict[str, _Target] = defaultdict(_Target)
        # With their arrival: stamps may be a little ahead of ours, or of the poses.
        self._early: list[tuple[str, Evidence, float]] = []
        self._faults: dict[tuple[Part, str], Fault] = {}
        self._news: list[Fault] = []
        self._ticked = -math.inf
        self._begun: float | None = None

    def take(self, event: Event) -> list[Answer]:
        """Take in an event. Answers come for `Tick` alone: one for each query, in their order."""
        self._begun = event.arrival if self._begun is None else self._begun
        match event:
            case Tick():
                return self._answers(event.arrival)
            case ImageReceived():
                self._image_received(event)
            case PoseReceived():
                self._pose_received(event)
            case ObservationReceived():
                self._observation_received(event)
            case Diagnostic() if event.text and event.passing:
                self._say(event.part, event.text, event.arrival)
            case Diagnostic():
                before = self._faults.get(key := (event.part, event.about))
                if event.text:
                    self._faults[key] = Fault(event.part, event.text, before.since if before else event.arrival)
                elif before:
                    del self._faults[key]
            case OdometryReset():
                self._tracker.reset()
                self._recent.clear()
                self._first, self._pose = math.inf, -math.inf
                self._spreads.clear()
                self._early.clear()
                self._targets.clear()
                self._say("poses", event.text, event.arrival)
            case QueriesChanged():
                for gone in {*self.queries} - {*event.queries}:
                    self._faults.pop(("perception", gone), None)
                    self._targets.pop(gone, None)
                    if gone in self._tracker.targets:
                        self._tracker.forget(gone)
                self._early = [each for each in self._early if each[0] in event.queries]
                self.queries = event.queries
        return []

    def orientation(self, stamp: float) -> np.ndarray | None:
        """`world_R_body` ``(3, 3)`` at the picture of this (its source's) stamp, as far as it is known by now."""
        ours = self._of_picture(stamp)
        if not self.has_poses or ours is None or math.isinf(self._pose):
            return None
        try:
            return self._tracker.pose_at(ours)[0]
        except EagorError:
            return None

    def posed(self, stamp: float) -> bool:
        """Whether `orientation` at the picture of this stamp is known, and not only held since the newest pose."""
        ours = self._of_picture(stamp)
        return not self.has_poses or (ours is not None and ours <= self._pose)

    def _image_received(self, event: ImageReceived) -> None:
        stamp = self._related(self._camera, event.stamp, event.arrival)
        if stamp is None:
            return
        if event.problem:
            self._say("camera", f"{event.name} is left out: {event.problem}", event.arrival)
        if self._camera.related and self._odometry.related:
            # Even the quickest picture comes later than the quickest pose of the same robot's clock.
            later = self._camera.shift - self._odometry.shift
            stamp -= later if 0 < later < ONE_CLOCK else 0.0
        self._pictures.append((event.stamp, stamp))
        if stamp > self._image:
            self._interval = stamp - self._image if math.isfinite(self._image) else 0.0
            self._image = stamp

    def _pose_received(self, event: PoseReceived) -> None:
        pose = event.pose
        if event.of_picture:
            stamp = self._of_picture(pose.stamp)
        else:
            stamp = self._related(self._odometry, pose.stamp, event.arrival)
        if stamp is None or (stamp := min(stamp, event.arrival)) <= self._pose:
            return  # out of order, or a stamp that contradicts the others: the next one will do
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # of far stamps: the age of the pose tells
                self._tracker.add_pose(stamp, pose.world_R_body, pose.position)
        except EagorError as error:
            self._say("poses", f"a pose is left out: {error}", event.arrival)
            return
        if pose.walks and pose.position is None:
            self._tracker.expect_parallax()
        self._recent.add(stamp, self._tracker.pose_at(stamp)[0])
        if pose.spread:
            self._spreads.append((stamp, pose.spread))
        for target in self._targets.values():
            if target.looked > self._pose:  # its look has waited for this pose, and is placed anew
                target.fresh, target.taken = True, -math.inf
        if math.isfinite(self._pose):
            self._beats.append(stamp - self._pose)
        self._pose, self._first = stamp, min(self._first, stamp)

    def _observation_received(self, event: ObservationReceived) -> None:
        stamp = self._of_picture(event.stamp)
        if event.query not in self.queries or stamp is None:
            return
        if stamp > event.arrival + FUTURE:
            self._say("clock", f"a picture of {stamp - event.arrival:.2f} s ahead of time is left out", event.arrival)
            return
        for look in event.looks:
            own = stamp if look.stamp is None else stamp + (look.stamp - event.told)
            if look.stamp is not None and event.told == stamp:  # to the last bit
                own = look.stamp
            self._early.append((event.query, replace(look, stamp=checked_stamp(own)), event.arrival))
        self._settle(event.arrival)

    def _settle(self, now: float) -> None:
        """Give the tracker the evidence that is not of the future, and whose pose is there or does not come."""
        early, self._early = self._early, []
        for query, look, arrival in early:
            stamp, target = look.stamp, self._targets[query]
            assert stamp is not None
            waits = self.has_poses and stamp > self._pose and now < arrival + WAITING and target.looked > -math.inf
            if stamp > now or waits:
                self._early.append((query, look, arrival))
                continue
            before = self._first - stamp
            stamp = self._first if 0 < before < math.inf else stamp
            spread = min(self._spreads, key=lambda each, stamp=stamp: abs(each[0] - stamp), default=(stamp, 0.0))[1]
            if HELD < before < math.inf:
                text = f"a look is left out: its picture was taken {before:.2f} s before the first pose"
                self._say("poses", text, now)
            elif spread >= UNSURE:
                text = f"a look is left out: its pose may be off by {math.degrees(spread):.0f} degrees"
                self._say("poses", text, now)
            else:
                try:
                    self._tracker.observe(replace(look, stamp=stamp).widened(spread), query)
                    target.looked, target.fresh = max(target.looked, stamp), True
                except EagorError as error:
                    self._say("perception", f"a look at {query!r} is left out: {error}", now)

    def _of_picture(self, stamp: float) -> float | None:
        """The stamp of a picture on our clock, as it was related when the picture came."""
        return next((ours for its, ours in reversed(list(self._pictures)) if its == stamp), None)

    def _related(self, clock: ClockSync, stamp: float, arrival: float) -> float | None:
        """A stamp on our clock; None where it contradicts the others."""
        try:
            ours, news = clock.take(stamp, arrival)
        except TimeError as error:
            ours, news = None, f"a stamp of the {clock.name} is left out: {error}"
        if news:
            self._say("clock", news, arrival)
        return ours

    def _say(self, part: Part, text: str, now: float) -> None:
        """Something that happened: it stays among the faults for a while."""
        others = [each for each in self._news if each.text != text]
        self._news = [*others[-8:], Fault(part, text, now)]

    def _answers(self, now: float) -> list[Answer]:
        self._settle(now)
        since, self._ticked = now - self._ticked, now
        faults, targets = tuple(self._wrong(now)), [self._targets[query] for query in self.queries]
        due = [pair for pair in zip(self.queries, targets, strict=True) if self._is_due(pair[1], now)]
        due.sort(key=lambda pair: -math.inf if pair[1].computed is None else pair[1].computed.stamp)
        # The same work in each round: a belief that waits is turned meanwhile.
        most = len(due) if self._exact else math.ceil(len(self.queries) * min(since / TOGETHER, 1.0) - 1e-9)
        for query, target in due[: max(1, most)]:
            self._compute(query, target, now)
        return [
            Answer(
                now, query, self._turned(query, target, now), now - self._pose if self.has_poses else None,
                now - target.looked, now - self._image, faults,
            )
            for query, target in zip(self.queries, targets, strict=True)
        ]  # fmt: skip

    def _is_due(self, target: _Target, now: float) -> bool:
        if target.computed is None or self._exact:
            return True
        age = now - target.computed.stamp
        if age < 0 or age >= REFRESHED or (target.fresh and now - target.taken >= TOGETHER):
            return True
        here = self._tracker.pose_at(now)[1]
        return target.position is not None and here is not None and math.dist(target.position, here) >= MOVED

    def _compute(self, query: str, target: _Target, now: float) -> Estimate:
        if target.fresh:
            target.fresh, target.taken = False, now
        pose, target.position = self._tracker.pose_at(now)
        if query in self._tracker.targets:
            target.computed = self._tracker.estimate(now, query)
        else:  # nothing was seen of it yet
            blank = State.blank(self.config, now, target.position).hypotheses
            target.computed = Estimate(now, math.inf, blank, pose, self.config)
        return target.computed

    def _turned(self, query: str, target: _Target, now: float) -> Estimate:
        """What was computed last, seen from where the camera points now."""
        full = target.computed or self._compute(query, target, now)
        if now <= self._pose or not self.has_poses:
            return full if now == full.stamp else full.turned(now, self._tracker.pose_at(now)[0])
        # A look without a pose of its time has the newest pose: what matters is how the camera has turned since.
        known = max(self._pose, target.looked)
        pose, spread = self._recent.after(now - known if self._extrapolates else 0.0)
        return full.turned(now, pose, spread)

    def _wrong(self, now: float) -> list[Fault]:
        """What is wrong at this time: what was reported, what is overdue, what has just happened."""
        begun = now if self._begun is None else self._begun
        found = list(self._faults.values())
        stale = max(STALE_IMAGE, INTERVALS * self._interval)
        if now - self._image > stale and now - begun > stale:
            found.append(_overdue("camera", "picture", now, self._image, begun))
        held = max(HELD, INTERVALS * median(self._beats)) if self._beats else HELD
        age = now - self._pose
        if self.has_poses and age > held and (math.isfinite(age) or now - begun > STARTING):
            fault = _overdue("poses", "pose", now, self._pose, begun)
            if age < STALE_POSE:
                fault = replace(fault, text=f"the last pose holds for {age:.2f} s already: the turn since is a guess")
            found.append(fault)
        looked = max((self._targets[query].looked for query in self.queries), default=math.inf)
        if min(now - looked, now - begun) > STALE_LOOK and not any(fault.part == "perception" for fault in found):
            found.append(_overdue("perception", "look", now, looked, begun))
        self._news = [each for each in self._news if now - each.since <= TOLD]
        return sorted([*found, *self._news], key=lambda fault: fault.since)


def warm(settings: LoopSettings) -> None:
    """Make the tables that the first answers need, which take tenths of a second, on a core of its own."""
    core = LiveCore(replace(settings, queries=("",)))
    for stamp in (1.0, 1.25, 1.5, 1.75):
        place = np.array([0.4 * stamp, 0.0, (settings.config.floor_height or 0.0) + 1.0])
        if settings.poses:
            core.take(PoseReceived(stamp, Pose(stamp, np.eye(3), place)))
        core.take(ImageReceived(stamp, stamp, ""))
        look = Evidence.from_points(np.array([[1.0, 0.1, 0.0], [0.0, 1.0, 0.1]]), scores=np.full(2, 0.8), stamp=stamp)
        core.take(ObservationReceived(stamp, stamp, stamp, "", (look,)))
        for answer in core.take(Tick(stamp + 0.2)):
            answer.as_dict()


def _overdue(part: Part, what: str, now: float, last: float, begun: float) -> Fault:
    if math.isinf(last):
        return Fault(part, f"no {what} yet, after {now - begun:.1f} s", begun)
    return Fault(part, f"no {what} for {now - last:.1f} s", last)
