"""Text from outside and for outside: small files in any encoding, settings, units of time, trajectories, safe words."""
