"""Drives that a DBC file describes."""
