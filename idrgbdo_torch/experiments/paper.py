"""What has been published for the recordings of the TUM benchmark: the paper's Table 1, and others' numbers."""

from __future__ import annotations

from dataclasses import dataclass, field


@dataclass(frozen=True)
class PaperRow:
    """One sequence: RPE in m/s and ATE in m; None where the paper has none."""

    dvo_rpe: float | None
    orb_rpe: float | None
    canny_rpe: float | None
    ours_rpe: float | None
    orb_ate: float | None
    canny_ate: float | None
    ours_ate: float | None


TABLE_1 = {
    "fr1_desk": PaperRow(0.024, 0.051, 0.031, 0.029, 0.065, 0.044, 0.051),
    "fr1_floor": PaperRow(0.232, 0.038, 0.010, 0.011, 0.061, 0.021, 0.020),
    "fr1_plant": PaperRow(0.025, 0.044, 0.036, 0.024, 0.067, 0.059, 0.039),
    "fr1_rpy": PaperRow(0.032, 0.037, 0.034, 0.026, 0.066, 0.047, 0.045),
    "fr1_xyz": PaperRow(0.018, 0.014, 0.019, 0.019, 0.009, 0.043, 0.043),
    "fr2_desk": PaperRow(None, 0.030, 0.008, 0.011, 0.213, 0.037, 0.030),
    "fr2_dishes": PaperRow(None, 0.035, 0.012, 0.015, 0.104, 0.033, 0.041),
    "fr2_rpy": PaperRow(None, 0.004, 0.004, 0.003, 0.004, 0.007, 0.007),
    "fr2_xyz": PaperRow(None, 0.005, 0.004, 0.003, 0.008, 0.008, 0.007),
    "fr3_cabinet": PaperRow(None, 0.071, 0.036, 0.058, 0.312, 0.057, 0.063),
    "fr3_large_cabinet": PaperRow(None, 0.100, 0.167, 0.049, 0.154, 0.317, 0.096),
    "fr3_long_office_household": PaperRow(None, 0.019, 0.010, 0.010, 0.276, 0.085, 0.038),
    "fr3_nostructure_texture_far": PaperRow(0.073, 0.121, 0.035, 0.037, 0.147, 0.026, 0.049),
    "fr3_nostructure_texture_near": PaperRow(0.028, 0.050, 0.043, 0.015, 0.111, 0.090, 0.062),
    "fr3_structure_notexture_far": PaperRow(0.039, 0.013, 0.027, 0.016, 0.008, 0.031, 0.018),
    "fr3_structure_notexture_near": PaperRow(0.021, 0.060, None, None, 0.091, None, None),
    "fr3_structure_texture_far": PaperRow(0.039, 0.018, 0.013, 0.012, 0.030, 0.013, 0.010),
    "fr3_structure_texture_near": PaperRow(0.041, 0.017, 0.010, 0.011, 0.045, 0.025, 0.013),
}


@dataclass(frozen=True)
class Published:
    """One column of numbers that others report."""

    label: str
    source: str
    rpe_m_per_s: dict[str, float]  # by sequence: RMSE of the translational drift over a second
    ate_m: dict[str, float] = field(default_factory=dict)


def _of_table_1(label: str, note: str, rpe: str, ate: str = "") -> Published:
    """A column of the paper's Table 1."""

    def column(name: str) -> dict[str, float]:
        values = {key: getattr(row, name) for key, row in TABLE_1.items()} if name else {}
        return {key: value for key, value in values.items() if value is not None}

    return Published(label, f"Fontan, Civera, Triebel, CVPR 2020, Table 1{note}", column(rpe), column(ate))


_RERUN = "re-run in 2026, RPE over 1 s; passed on to this project, not measured here"
PUBLISHED = (
    _of_table_1("ID-RGBDO", ": 24 points a keyframe", "ours_rpe", "ours_ate"),
    _of_table_1("Canny-VO", "", "canny_rpe", "canny_ate"),
    _of_table_1("ORB-SLAM2 odometry", ": without loop closing", "orb_rpe", "orb_ate"),
    _of_table_1("DVO SLAM", ": for fr1 with its pose graph, so no odometry", "dvo_rpe"),
    Published(
        "DVO odometry",
        "Kerl, Sturm, Cremers, IROS 2013: dense, against keyframes, without the pose graph",
        {
            "fr1_desk": 0.030, "fr1_desk2": 0.055, "fr1_room": 0.048, "fr1_360": 0.119, "fr1_floor": 0.090,
            "fr1_xyz": 0.024, "fr1_rpy": 0.040, "fr1_plant": 0.036,
        },
    ),
    Published(
        "ORB-SLAM3", _RERUN, {"fr1_desk2": 0.0359, "fr1_xyz": 0.0172, "fr1_room": 0.0532, "fr1_360": 0.181}
    ),
    Published(
        "Photo-SLAM", _RERUN, {"fr1_desk2": 0.0335, "fr1_xyz": 0.0154, "fr1_room": 0.0430, "fr1_360": 0.144}
    ),
    Published("GS-ICP SLAM", _RERUN, {"fr1_desk2": 0.0964, "fr1_xyz": 0.0251, "fr1_room": 0.0766, "fr1_360": 0.420}),
)  # fmt: skip
SEQUENCES = tuple(dict.fromkeys([*TABLE_1, *(name for column in PUBLISHED for name in column.rpe_m_per_s)]))
