"""Open3D's legacy odometry with its makers' defaults. Its success flag is always true, so it is not read."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
import torch
from torch import Tensor

from idrgbdo_torch.frame import RgbdFrame
from idrgbdo_torch.odometry import FrameToFrame
from idrgbdo_torch.tracker.open3d_loader import load_open3d

from .checked import Raw, checked

Term = Literal["Color", "Hybrid"]
DEPTH_MAX = 4.0  # m, the default of OdometryOption


def make(term: Term) -> FrameToFrame:
    """Frame-to-frame odometry: colour alone (Steinbrücker et al. 2011) or with depth (Park et al. 2017)."""
    return FrameToFrame(checked(aligner(term)), f"Open3D legacy {term.lower()}")


def aligner(term: Term) -> Raw:
    """The bare pairwise method."""
    o3d = load_open3d()
    odometry = o3d.pipelines.odometry
    jacobian = getattr(odometry, f"RGBDOdometryJacobianFrom{term}Term")()

    def align(source: RgbdFrame, target: RgbdFrame, guess: Tensor) -> Tensor | str:
        c = source.camera
        intrinsic = o3d.camera.PinholeCameraIntrinsic(c.width, c.height, c.fx, c.fy, c.cx, c.cy)
        images = (_image(o3d, source), _image(o3d, target))
        _, T_target_source, _ = odometry.compute_rgbd_odometry(*images, intrinsic, guess.numpy(), jacobian)
        return torch.from_numpy(np.array(T_target_source))

    return align


def _image(o3d: Any, frame: RgbdFrame) -> Any:
    """Intensity in 0..1 and depth in metres, both float32."""
    gray = o3d.geometry.Image(frame.gray.numpy() / np.float32(255))
    depth = o3d.geometry.Image(np.where(frame.depth.numpy() < DEPTH_MAX, frame.depth.numpy(), np.float32(0)))
    return o3d.geometry.RGBDImage.create_from_color_and_depth(
        gray, depth, depth_scale=1.0, depth_trunc=DEPTH_MAX, convert_rgb_to_intensity=False
    )
