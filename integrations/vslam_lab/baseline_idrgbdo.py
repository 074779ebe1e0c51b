"""For VSLAM-LAB's folder Baselines/baseline_files: what it has to know of this method."""

from __future__ import annotations

from Baselines.BaselineVSLAMLAB import BaselineVSLAMLAB  # its own


class IDRGBDO_baseline(BaselineVSLAMLAB):
    """Information-driven direct RGB-D odometry."""

    def __init__(self, baseline_name: str = "idrgbdo", baseline_folder: str = "idrgbdo_torch") -> None:
        super().__init__(baseline_name, baseline_folder, {"verbose": 1, "mode": "rgbd"})
        self.color = (0.76, 0.25, 0.05)
        self.modes = ["rgbd"]
        self.cam_models = ["pinhole", "radtan4", "radtan5"]
        self.command_style = "python"
