"""What `idrgbdo live` does; what it asks for stands in options.py, beside the settings that it shares."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from .options import LiveCommand


def live(command: LiveCommand) -> int:
    """Track a camera until it stops, max_frames are reached, or Ctrl-C."""
    from .commands import track
    from .live import open_camera
    from .viewer import open_viewer

    sequence = open_camera(
        command.sensor,
        camera=command.camera,
        record=command.record,
        depth_scale=command.depth_scale,
        max_frames=command.max_frames,
    )
    print("reading", sequence.recognised, flush=True)
    with open_viewer(sequence.name, command.viewer, command.save_rrd) as viewer:
        return track(sequence, sequence.name, command.settings, command.out, viewer=viewer)
