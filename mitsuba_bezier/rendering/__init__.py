"""Renders in many passes: kept while they are made, continued, shared by machines, denoised."""
