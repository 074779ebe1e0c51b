"""`idrgbdo evaluate`: two trajectories compared."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from ..text.configfile import Positive
from .output import Output, answer


@dataclass(frozen=True)
class EvaluateCommand:
    """Compare a trajectory with a reference: ATE and RPE."""

    estimate: Positional[Path]  # TUM text, or the folder of a run
    groundtruth: Positional[Path]  # TUM text, or the folder of a recording
    association_limit: Positive = 0.02  # s, between an estimated and a reference pose
    output: Annotated[Output, arg(name="")] = field(default_factory=Output)


def evaluate(command: EvaluateCommand) -> int:
    """Compare two trajectories."""
    from ..errors import IdRgbdoError
    from ..evaluation import evaluate as evaluate_trajectory
    from ..evaluation import hints
    from ..report.terminal import evaluation_rows, hint_rows, show_table
    from ..runs.folder import evaluation_summary
    from ..trajectory import read_tum
    from .input import file_in, reference_of

    estimate = read_tum(file_in(command.estimate, "trajectory.txt"))
    reference = reference_of(command.groundtruth)
    noticed = hints(estimate, reference, command.association_limit)
    try:
        evaluation = evaluate_trajectory(estimate, reference, max_difference_s=command.association_limit)
    except IdRgbdoError as error:
        raise IdRgbdoError("; ".join((str(error), *noticed))) from error
    counts = f"{evaluation.matched_poses} of {len(estimate)} estimated, of {len(reference)} reference poses"
    rows = [*evaluation_rows(evaluation, both=True)[:-1], ("matched poses", counts), *hint_rows(noticed)]
    show_table(str(command.estimate), rows)
    answer(**evaluation_summary(evaluation), notes=noticed)
    return 0
