"""The emulated mechanics: axes, friction, membranes."""
