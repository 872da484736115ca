"""The integrators, and what they share."""
