"""The emulated stage: physics, servo drives and their misbehaviour. Knows nothing of the controller."""
