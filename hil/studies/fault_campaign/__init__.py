"""The fault campaign: every fault, in every state and phase, on every axis, in lockstep."""
