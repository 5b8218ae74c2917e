"""Emulated nodes beside the drives."""
