"""The paper's experiments, one file each: `run(lab)` measures, decides what the paper claims, and draws."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from .lab import Lab, Report

NAMES = (
    *("fig1", "fig3", "fig4", "fig5", "fig6", "fig7", "fig8", "table1", "ablation", "frontier"),
    *("coverage", "faults", "events"),
)


def run_experiment(name: str, lab: Lab) -> Report:
    """The report of one of NAMES."""
    report: Report = import_module(f"{__name__}.{name}").run(lab)
    return report
