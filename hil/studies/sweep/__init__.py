"""Thousands of plants with seeded parameters under one rig."""
