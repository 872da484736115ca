"""Renders held against stored references by pytest: plugin, fixture, artefacts, reports."""
