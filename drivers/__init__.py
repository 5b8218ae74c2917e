"""The CAN side of the rig: buses, frame layouts, a simulated wire, schedulability. Usable without hil."""
