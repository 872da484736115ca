"""Leaves that are whole patches on quadrics, met in closed form."""
