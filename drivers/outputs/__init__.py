"""Outputs: a node that switches valves, pulses and lights, beside any frame layout."""
