"""Sensors: nodes that measure something else than an axis' position, beside any frame layout."""
