"""`make attacks`: what somebody who means harm, or knows no better, can do to a live rig; each tried, each expected to
fail. Needs root, to become other users and to make network namespaces.
"""
