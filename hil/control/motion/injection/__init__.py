"""Injecting a batch of cells: phases that end by evidence, detectors on the force, and a verdict for each cell.

The paper strikes by a plan and stops before the cell; this begins where it ends.
"""
