"""What decides: which points, which pose, which keyframe, whether to believe it."""
