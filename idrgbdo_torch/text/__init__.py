"""Text from outside and for outside: small files in any encoding, units of times, trajectories, safe words."""
