"""A run handed on: to splat and NeRF trainers, COLMAP, trajectory tools, robots."""
