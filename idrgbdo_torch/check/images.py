"""What single images show: range and share of the depth, blur, brightness."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from .samples import Bytes, Floats, Sample

NEIGHBOURHOOD = 13  # px around an edge
STRONGEST = 0.98  # quantile of the gradient above which a pixel is a strong edge
CONTRAST = 20.0  # gray levels that a strong edge spans


@dataclass(frozen=True)
class ImageStatistics:
    """Of one frame."""

    valid: float  # share of pixels with depth
    depth_m: tuple[float, float, float]  # 5 %, median, 95 %; NaN without depth
    edge_px: float  # width of the strong edges; NaN without any
    brightness: float  # mean gray level


def statistics(sample: Sample) -> ImageStatistics:
    """Measure one frame."""
    depth = sample.depth[sample.depth > 0]
    low, middle, high = np.percentile(depth, [5, 50, 95]) if len(depth) else [np.nan] * 3
    return ImageStatistics(
        valid=len(depth) / sample.depth.size,
        depth_m=(float(low), float(middle), float(high)),
        edge_px=edge_width(sample.gray),
        brightness=float(sample.gray.mean()),
    )


def edge_width(gray: Bytes | Floats) -> float:
    """Median width (px) of the strong edges: the gray levels that an edge spans over its steepest slope."""
    image = gray.astype(np.float32)
    slope = np.hypot(*(cv2.Scharr(image, cv2.CV_32F, *order, scale=1 / 32) for order in ((1, 0), (0, 1))))
    kernel = np.ones((NEIGHBOURHOOD, NEIGHBOURHOOD), np.uint8)
    span = cv2.dilate(image, kernel) - cv2.erode(image, kernel)
    strong = (slope >= np.quantile(slope, STRONGEST)) & (span >= CONTRAST)
    return float(np.median(span[strong] / np.maximum(slope[strong], 1e-6))) if strong.any() else float("nan")
