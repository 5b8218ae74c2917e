"""Offline questions about a rig, each answered by many simulations; nothing here runs at the stage.

No study imports another, except compare.cases, which takes from tune.search_space how gains scale with the rate. In
each, `command` is the command line's thin shell; the rest never prints, exits or reads arguments.
"""
