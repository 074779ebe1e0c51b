"""Open3D's tensor odometry with its makers' defaults, three levels and three losses."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
import torch
from torch import Tensor

from idrgbdo_torch.frame import RgbdFrame
from idrgbdo_torch.odometry import FrameToFrame
from idrgbdo_torch.tracker.open3d_loader import load_open3d

from .checked import Raw, checked

Loss = Literal["PointToPlane", "Intensity", "Hybrid"]


def make(loss: Loss) -> FrameToFrame:
    """Frame-to-frame odometry with one of the three losses."""
    return FrameToFrame(checked(aligner(loss)), f"Open3D tensor {loss}")


def aligner(loss: Loss) -> Raw:
    """The bare pairwise method. "Singular 6x6" (no overlap, or a direction left free) becomes a sentence."""
    o3d = load_open3d()
    odometry = o3d.t.pipelines.odometry
    method = getattr(odometry.Method, loss)

    def align(source: RgbdFrame, target: RgbdFrame, guess: Tensor) -> Tensor | str:
        K, T_init = (o3d.core.Tensor(np.ascontiguousarray(x.numpy())) for x in (source.camera.matrix(), guess))
        images = (_image(o3d, source), _image(o3d, target))
        try:
            result = odometry.rgbd_odometry_multi_scale(*images, K, T_init, depth_scale=1.0, method=method)
        except RuntimeError as error:
            return f"Open3D gave up: {' '.join(str(error).split())}"
        return torch.from_numpy(result.transformation.numpy().copy())

    return align


def _image(o3d: Any, frame: RgbdFrame) -> Any:
    """Colour (gray where there is none) as bytes, and depth in metres."""
    gray = frame.gray.round().clamp(0, 255).to(torch.uint8)[..., None].expand(-1, -1, 3)
    color = gray if frame.color is None else frame.color
    color_image = o3d.t.geometry.Image(np.ascontiguousarray(color.numpy()))
    return o3d.t.geometry.RGBDImage(color_image, o3d.t.geometry.Image(frame.depth.numpy()[..., None].copy()))
