"""A run on disk: its folder, the checkpoint to go on from, what was tracked, the mesh; a live camera in a loop."""
