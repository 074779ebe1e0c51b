"""LaTeX tables: what booktabs wants, every sign as it stands."""

from __future__ import annotations

from idrgbdo_torch.text.latex import booktabs, escaped


def test_signs_that_mean_something_to_latex_are_written_out() -> None:
    assert escaped(r"50 % of a_b & c\d {x} ~ ^ # $") == (
        r"50 \% of a\_b \& c\textbackslash{}d \{x\} \textasciitilde{} \textasciicircum{} \# \$"
    )


def test_numbers_stand_right_names_left_what_is_missing_is_a_dash() -> None:
    rows = [("ours_24", "1.25", "12.0 ± 0.5 (13.1)"), ("dense", "", "9.0")]
    text = booktabs(("method", "RPE mm/s", "ATE mm"), rows, "fr1/desk", "fr1/desk: all", {(0, 1)})
    lines = [line.strip() for line in text.splitlines()]
    assert r"\begin{tabular}{lrr}" in lines and r"\label{tab:fr1-desk-all}" in lines
    assert lines[lines.index(r"\midrule") + 1] == r"ours\_24 & \textbf{1.25} & 12.0 $\pm$ 0.5 (13.1) \\"
    assert r"dense & -- & 9.0 \\" in lines
    order = [lines.index(rule) for rule in (r"\toprule", r"\midrule", r"\bottomrule")]
    assert order == sorted(order) and text.count(r"\begin") == text.count(r"\end") == 2
