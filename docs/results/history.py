"""A row a method into history.csv for a release, from the CSV files of `idrgbdo experiment table1`, and the plot.

    python docs/results/history.py VERSION COMMIT MACHINE

Needs the extra `experiments`. A version that is there already is replaced.
"""

from __future__ import annotations

import csv
import sys
from pathlib import Path
from statistics import median

HERE = Path(__file__).parent
HISTORY = HERE / "history.csv"
PLOT = HERE.parent / "images" / "results" / "history.png"
COMMAND = "idrgbdo experiment table1 --rendered --trajectories groundtruth"
METHODS = ("ours-24", "ours-256")
FIGURES = {"rpe_mm_per_s": "table1_rpe.csv", "ate_mm": "table1_ate.csv", "ms": "table1_ms.csv"}
COLUMNS = ("version", "method", *FIGURES, "sequences", "commit", "machine", "command")


def medians(method: str) -> dict[str, str]:
    """The figures of a method, medians over the sequences, to three digits."""
    row = {}
    for name, file in FIGURES.items():
        with (HERE / file).open(encoding="utf-8") as lines:
            values = [float(line[method]) for line in csv.DictReader(lines) if line[method]]
        row[name] = f"{median(values):.3g}"
        row["sequences"] = str(len(values))
    return row


def rows() -> list[dict[str, str]]:
    """What the history holds."""
    if not HISTORY.exists():
        return []
    with HISTORY.open(encoding="utf-8") as file:
        return list(csv.DictReader(file))


def add(version: str, commit: str, machine: str) -> None:
    """The rows of a version at the end of the history."""
    kept = [row for row in rows() if row["version"] != version]
    about = {"version": version, "commit": commit, "machine": machine, "command": COMMAND}
    kept += [{**about, "method": method, **medians(method)} for method in METHODS]
    with HISTORY.open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, COLUMNS, lineterminator="\n")
        writer.writeheader()
        writer.writerows(kept)


def plot() -> None:
    """Every figure over the versions, a line a method."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    titles = {"rpe_mm_per_s": "RPE, mm/s", "ate_mm": "ATE, mm", "ms": "ms a frame"}
    figure, axes = plt.subplots(1, len(titles), figsize=(9, 2.6), constrained_layout=True)
    for axis, (name, title) in zip(axes, titles.items(), strict=True):
        for method, color in zip(METHODS, ("#c2410c", "#3f88c5"), strict=True):
            mine = [row for row in rows() if row["method"] == method]
            axis.plot(
                [row["version"] for row in mine], [float(row[name]) for row in mine], "o-", color=color, label=method
            )
        axis.set_title(title, fontsize=10)
        axis.set_ylim(bottom=0)
        axis.grid(axis="y", color="#e6eaee")
    axes[0].legend(fontsize=8)
    figure.savefig(PLOT, dpi=110)


if __name__ == "__main__":
    if len(sys.argv) != 4:
        sys.exit(__doc__)
    add(*sys.argv[1:])
    plot()
