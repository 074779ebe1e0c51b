"""The verdict on the camera's numbers as the motion shows them."""

from __future__ import annotations

from collections.abc import Collection

from ..definitions.camera import Pinhole
from ..tracker.camera_estimate import CameraEstimate
from .findings import Finding, Verdict

NAME = "camera file"


def camera_file(estimate: CameraEstimate | None, camera: Pinhole) -> Finding | None:
    """Never a fault: small errors cost accuracy, not the track. None where too few keyframes moved to tell anything."""
    if estimate is None:
        return None
    seen, hidden = estimate.in_words()
    value = f"motion shows {', '.join(seen)}" if seen else "motion shows nothing of its numbers"
    if seen and hidden:
        value += f"; not {', '.join(hidden)}"
    found = estimate.departures(camera)
    if not found:
        return Finding(NAME, Verdict.GOOD if seen else Verdict.UNKNOWN, value)
    tried = "\n".join(lines(found, estimate, camera))
    advice = (
        f"it costs accuracy; try in the camera file, and check again\n{tried}" if tried else "no camera file can say it"
    )
    return Finding(NAME, Verdict.NOTE, value, advice)


def lines(found: Collection[str], estimate: CameraEstimate, camera: Pinhole) -> list[str]:
    """Those of camera.toml for the numbers that depart from what is said; a table comes last."""
    factor = estimate.focal_factor.value
    cx, cy = camera.cx + estimate.center_u_px.value, camera.cy + estimate.center_v_px.value
    values = {
        "focal": f"fx = {factor * camera.fx:.1f}\nfy = {factor * camera.fy:.1f}",
        "cx": f"cx = {cx:.1f}",
        "cy": f"cy = {cy:.1f}",
        "depth_growth": f"depth_growth = {estimate.depth_growth.value:.4f}  # added to what is there",
        "depth_delay_ms": f"depth_delay_ms = {estimate.depth_delay_ms.value:.0f}",
        "readout_ms": f"readout_ms = {estimate.readout_ms.value:.0f}",
    }
    out = [line for name, line in values.items() if name in found]
    if "depth_right" in found or "depth_down" in found:
        fx, fy = (factor * f if "focal" in found else f for f in (camera.fx, camera.fy))
        x = (cx if "cx" in found else camera.cx) + estimate.depth_right_px.value
        y = (cy if "cy" in found else camera.cy) + estimate.depth_down_px.value
        out.append(f"[depth]\nfx = {fx:.1f}\nfy = {fy:.1f}\ncx = {x:.1f}\ncy = {y:.1f}")
    return out
