"""Outcomes laid side by side: means over seeds and sequences, speed against the fastest baseline, agreement."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from statistics import fmean, pstdev

from ..evaluation import relative_error
from ..trajectory import Trajectory, read_tum
from .outcome import Outcome


@dataclass(frozen=True)
class Spread:
    """A figure over seeds, or over sequences."""

    mean: float
    std: float
    worst: float
    count: int


@dataclass(frozen=True)
class Row:
    """One method on one sequence, or on all of them."""

    method: str
    sequence: str  # empty for all
    outcomes: tuple[Outcome, ...]  # over the seeds (and sequences)
    fastest_baseline_ms: float | None

    @property
    def description(self) -> str:
        """One line about the method."""
        return self.outcomes[0].description

    @property
    def error(self) -> str:
        """Why the method broke; empty when it did not."""
        return next((outcome.error for outcome in self.outcomes if outcome.error), "")

    @property
    def track_ms(self) -> float | None:
        """Median milliseconds a frame (mean of the medians)."""
        return _mean(outcome.track_ms_median for outcome in self.outcomes)

    @property
    def track_ms_p95(self) -> float | None:
        """95 % of the frames took no longer."""
        return _mean(outcome.track_ms_p95 for outcome in self.outcomes)

    @property
    def peak_memory_mb(self) -> float | None:
        """The most memory over all runs."""
        known = [outcome.peak_memory_mb for outcome in self.outcomes if outcome.peak_memory_mb is not None]
        return max(known, default=None)

    @property
    def speedup(self) -> float | None:
        """How many times as fast as the fastest baseline."""
        ms = self.track_ms
        return self.fastest_baseline_ms / ms if ms and self.fastest_baseline_ms else None

    @property
    def frames(self) -> int:
        """Of all runs together."""
        return sum(outcome.frames for outcome in self.outcomes)

    @property
    def lost(self) -> int:
        """Of all runs together."""
        return sum(outcome.lost for outcome in self.outcomes)

    @property
    def breaks(self) -> int:
        """Times that a track was lost and went on later, of all runs together."""
        return sum(outcome.breaks for outcome in self.outcomes)

    @property
    def found_again(self) -> int:
        """Of these, how many went on where they had been."""
        return sum(outcome.found_again for outcome in self.outcomes)

    @property
    def weak(self) -> int:
        """Of all runs together."""
        return sum(outcome.weak for outcome in self.outcomes)

    @property
    def matched_poses(self) -> int:
        """Of all runs together: what the ATE is made of."""
        return sum(outcome.matched_poses for outcome in self.outcomes)

    @property
    def rpe_pairs(self) -> int:
        """Of all runs together: what the RPE is made of."""
        return sum(outcome.rpe_pairs for outcome in self.outcomes)

    @property
    def made_of(self) -> str:
        """Poses and pairs behind the errors where the reference covers a part of the frames; empty where all."""
        if not 0 < self.matched_poses < self.frames:
            return ""
        return f"{self.matched_poses} of {self.frames} poses, {self.rpe_pairs} pairs"

    @property
    def reasons(self) -> dict[str, int]:
        """Why frames were lost, the commonest first."""
        total: dict[str, int] = {}
        for outcome in self.outcomes:
            for reason, count in outcome.reasons.items():
                total[reason] = total.get(reason, 0) + count
        return dict(sorted(total.items(), key=lambda item: -item[1]))

    def spread(self, name: str) -> Spread | None:
        """Mean, standard deviation and worst of a figure such as "ate_rmse_m"; None unless every run has it."""
        values = [getattr(outcome, name) for outcome in self.outcomes]
        if not values or any(value is None for value in values):
            return None
        return Spread(fmean(values), pstdev(values), max(values), len(values))


@dataclass(frozen=True)
class Agreement:
    """How far any two methods are from each other on one sequence, which needs no reference."""

    sequence: str
    methods: tuple[str, ...]
    rpe_m_per_s: tuple[tuple[float | None, ...], ...]  # symmetric; None where two have no second in common

    @property
    def of(self) -> dict[tuple[str, str], float | None]:
        """By the pair of names."""
        pairs = zip(self.methods, self.rpe_m_per_s, strict=True)
        return {(a, b): value for a, row in pairs for b, value in zip(self.methods, row, strict=True)}


@dataclass(frozen=True)
class Comparison:
    """The outcomes of a call of compare()."""

    outcomes: tuple[Outcome, ...]
    folder: Path
    groundtruths: Mapping[str, Trajectory | None]  # by sequence

    @property
    def methods(self) -> tuple[str, ...]:
        """In the order in which they were given."""
        return tuple(dict.fromkeys(outcome.method for outcome in self.outcomes))

    @property
    def sequences(self) -> tuple[str, ...]:
        """In the order in which they were given."""
        return tuple(self.groundtruths)

    def rows(self, sequence: str = "") -> list[Row]:
        """A row for each method on one sequence, or over all of them (those that ran on every one)."""
        wanted = {sequence} if sequence else set(self.sequences)
        chosen = [outcome for outcome in self.outcomes if outcome.sequence in wanted]
        by_method = {name: tuple(o for o in chosen if o.method == name) for name in self.methods}
        complete = {name: runs for name, runs in by_method.items() if {o.sequence for o in runs} == wanted}
        fastest = min(
            (ms for runs in complete.values() if runs[0].kind == "baseline" and (ms := _median_ms(runs)) is not None),
            default=None,
        )
        return [Row(name, sequence, runs, fastest) for name, runs in complete.items()]

    def trajectory(self, method: str, sequence: str) -> Trajectory | None:
        """The causal poses of a method's first run; None where it broke."""
        for outcome in self.outcomes:
            if (outcome.method, outcome.sequence) == (method, sequence) and not outcome.error:
                return self._trajectories[outcome.folder]
        return None

    @cached_property
    def _trajectories(self) -> dict[str, Trajectory]:
        folders = {outcome.folder for outcome in self.outcomes if not outcome.error}
        return {folder: read_tum(self.folder / folder / "trajectory.txt") for folder in folders}

    def agreement(self, sequence: str) -> Agreement:
        """RPE between every pair of methods on a sequence."""
        found = {name: self.trajectory(name, sequence) for name in self.methods}
        known = {name: trajectory for name, trajectory in found.items() if trajectory is not None}
        values = {(a, b): _distance(known[a], known[b]) for i, a in enumerate(known) for b in list(known)[i + 1 :]}
        matrix = tuple(tuple(0.0 if a == b else values.get((a, b), values.get((b, a))) for b in known) for a in known)
        return Agreement(sequence, tuple(known), matrix)


def _distance(a: Trajectory, b: Trajectory) -> float | None:
    error = relative_error(a, b)
    return None if error is None else error.rmse_m_per_s


def _median_ms(outcomes: Sequence[Outcome]) -> float | None:
    return _mean(outcome.track_ms_median for outcome in outcomes)


def _mean(values: Iterable[float | None]) -> float | None:
    """None unless every value is known."""
    known: list[float] = []
    for value in values:
        if value is None:
            return None
        known.append(value)
    return fmean(known) if known else None
