"""Offline questions about laws and plants; nothing here runs at the rig."""
